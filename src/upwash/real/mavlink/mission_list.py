"""Lists that a vehicle keeps, such as its fence and its rally points, by MAVLink's mission protocol."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.mavlink.packets import Message
from upwash.real.mavlink.vehicle import MavlinkVehicle

_ATTEMPTS = 5
MOST_ITEMS = 1_000
_LONGEST_S = 600.0
_UNKNOWN = (mavlink.MAV_MISSION_UNSUPPORTED, mavlink.MAV_MISSION_DENIED)


@dataclass(frozen=True, slots=True)
class MissionList:
    """One of a vehicle's lists, by its MAV_MISSION_TYPE; `name` is "fence", or what else a person calls it."""

    number: int
    name: str

    async def read(self, vehicle: MavlinkVehicle) -> list[Message]:
        """Its items, in order; none if the vehicle keeps no list of this type.

        Raises AutopilotTimeout if the vehicle does not tell all of them.
        """
        async with vehicle.limited(self.name, _LONGEST_S):
            count = await self.count(vehicle)
            if count > MOST_ITEMS:
                problem = f"the vehicle's {self.name} has {count} items, more than {MOST_ITEMS}"
                raise AutopilotTimeout(self.name, problem)
            items = [await self._item(vehicle, number) for number in range(count)]
            accepted = mavlink.MAV_MISSION_ACCEPTED  # without this PX4 reports a failed transfer
            vehicle.ask(mavlink.MAVLink_mission_ack_message(*vehicle.ids, accepted, self.number))
        return items

    async def count(self, vehicle: MavlinkVehicle) -> int:
        """The number of its items; AutopilotTimeout without an answer."""
        question = mavlink.MAVLink_mission_request_list_message(*vehicle.ids, self.number)
        answer = await self._asked(
            vehicle, question, "how many items it has", ("MISSION_COUNT", "MISSION_ACK")
        )
        return answer.count if answer.get_type() == "MISSION_COUNT" else 0

    async def _item(self, vehicle: MavlinkVehicle, number: int) -> Message:
        question = mavlink.MAVLink_mission_request_int_message(*vehicle.ids, number, self.number)
        return await self._asked(vehicle, question, f"item {number}", ("MISSION_ITEM_INT",), seq=number)

    async def _asked(
        self,
        vehicle: MavlinkVehicle,
        question: Message,
        what: str,
        kinds: tuple[str, ...],
        seq: int | None = None,
    ) -> Message:
        answers: list[Message] = []

        def hear(message: Message) -> None:
            kind = message.get_type()
            if kind not in kinds or message.mission_type != self.number:
                return
            is_refused = kind == "MISSION_ACK" and message.type in _UNKNOWN
            if is_refused or (kind != "MISSION_ACK" and seq in (None, getattr(message, "seq", None))):
                answers.append(message)

        with vehicle.listening(hear):
            if await vehicle.answered(
                self.name, lambda: vehicle.ask(question), lambda: answers, times=_ATTEMPTS
            ):
                return answers[0]
        raise AutopilotTimeout(
            self.name, f"the vehicle did not tell {what} of its {self.name}: try again", vehicle.said_lately
        )

    def nonsense(self, what: str) -> AutopilotRefused:
        """The refusal of a list whose items make no sense."""
        remedy = f"upload the {self.name} anew; nothing was sent"
        return AutopilotRefused(self.name, f"the vehicle's {self.name} makes no sense: {what}; {remedy}")
