"""Which of the autopilots on a link is the vehicle that is followed."""

from __future__ import annotations

from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.names import name_of
from upwash.real.mavlink.firmware import Firmware
from upwash.real.mavlink.hearing import Message, from_autopilot

_COPTERS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HELICOPTER,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
)


class Identity:
    """The first autopilot heard that can be flown; `firmwares` are those that can."""

    def __init__(self, firmwares: Sequence[Firmware]) -> None:
        self.firmware = firmwares[0]
        self.ids: tuple[int, int] | None = None  # its system and component
        self._firmwares = {each.autopilot: each for each in firmwares}
        self._unflyable: tuple[int, int] | None = None  # MAV_AUTOPILOT and MAV_TYPE of another that was heard

    def follows(self, message: Message) -> bool:
        """Whether it is the heartbeat of the vehicle, or of one that can be flown while there is none."""
        if not from_autopilot(message):
            return False
        if self.ids is not None:
            return sender_of(message) == self.ids
        flyable = message.autopilot in self._firmwares and message.type in _COPTERS
        if not flyable:
            self._unflyable = message.autopilot, message.type
        return flyable

    def meet(self, message: Message) -> bool:
        """Takes the sender of a heartbeat for the vehicle, where there is none and it can be; whether it did."""
        if self.ids is not None or not self.follows(message):
            return False
        self.ids, self.firmware = sender_of(message), self._firmwares[message.autopilot]
        return True

    def why_unflyable(self, connection: str, within_s: float) -> str:
        """Why what was heard cannot be flown; empty where nothing was."""
        if self._unflyable is None:
            return ""
        autopilot, kind = self._unflyable
        return (
            f"{name_of('MAV_AUTOPILOT', autopilot)} with {name_of('MAV_TYPE', kind)} was heard on {connection}, "
            f"and nothing else within {within_s:g} s; only multicopters with "
            f"{' or '.join(each.name for each in self._firmwares.values())} can be flown"
        )


def sender_of(message: Message) -> tuple[int, int]:
    """Its system and component."""
    return message.get_srcSystem(), message.get_srcComponent()
