"""Which of the autopilots on a link is the vehicle that is followed.

Evidence, and what it is taken for:

- A heartbeat of component 1 that names ArduPilot or PX4 and the type of a vehicle is an autopilot's. Gimbals,
  cameras, ground stations and companion computers have other types or no autopilot, and never count.
- Two systems with an autopilot are two vehicles. The configuration has to name the vehicle to fly.
- A heartbeat with the followed ids and another autopilot or type is another program's. It says nothing
  of the vehicle.
- Two clocks since boot, or two serial numbers of hardware, with the followed ids are two vehicles with one system id.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.eventlog.schema import LinkTroubleName
from upwash.mavlink.names import name_of
from upwash.ports import LinkTrouble
from upwash.real.mavlink.firmware import Firmware
from upwash.real.mavlink.hearing import Message, from_autopilot
from upwash.real.mavlink.twins import Twins

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
_OTHER_VEHICLES = (
    mavlink.MAV_TYPE_FIXED_WING,
    mavlink.MAV_TYPE_AIRSHIP,
    mavlink.MAV_TYPE_FREE_BALLOON,
    mavlink.MAV_TYPE_GROUND_ROVER,
    mavlink.MAV_TYPE_SURFACE_BOAT,
    mavlink.MAV_TYPE_SUBMARINE,
    mavlink.MAV_TYPE_VTOL_DUOROTOR,
    mavlink.MAV_TYPE_VTOL_QUADROTOR,
    mavlink.MAV_TYPE_VTOL_TILTROTOR,
    mavlink.MAV_TYPE_GENERIC_MULTIROTOR,
)
_AUTOPILOTS = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}


@dataclass(frozen=True, slots=True)
class Heard:
    """An autopilot as its heartbeat tells it; `firmware` is empty where it cannot be flown."""

    system: int
    component: int
    autopilot: int  # MAV_AUTOPILOT
    type: int  # MAV_TYPE
    firmware: str = ""

    @property
    def kind(self) -> str:
        """Its type in words, such as "quadrotor"."""
        return name_of("MAV_TYPE", self.type).removeprefix("MAV_TYPE_").replace("_", " ").lower()

    @property
    def is_vehicle(self) -> bool:
        """Whether it may be taken for another vehicle; antenna trackers and the like have autopilots too."""
        return self.autopilot in _AUTOPILOTS and self.type in (*_COPTERS, *_OTHER_VEHICLES)

    @property
    def runs(self) -> str:
        """What it runs and is, such as "ArduCopter quadrotor"."""
        runs = self.firmware or _AUTOPILOTS.get(self.autopilot) or name_of("MAV_AUTOPILOT", self.autopilot)
        return f"{runs} {self.kind}"

    def __str__(self) -> str:
        return f"system {self.system}, component {self.component} ({self.runs})"


class Identity:
    """The followed vehicle: it has that `system`, or without `system` it is the only vehicle.

    `firmwares` are those that can be flown. `tell` is called with what a person should know of who else is on the
    link, once for each kind.
    """

    def __init__(
        self,
        firmwares: Sequence[Firmware],
        *,
        system: int | None = None,
        tell: Callable[[LinkTrouble], None] = lambda _: None,
    ) -> None:
        self.firmware = firmwares[0]
        self.vehicle: Heard | None = None
        self.system = system
        self._firmwares = {each.autopilot: each for each in firmwares}
        self._tell = tell
        self._told: set[LinkTroubleName] = set()
        self._heard: dict[int, Heard] = {}  # by system
        self._twins = Twins()

    @property
    def ids(self) -> tuple[int, int] | None:
        """The followed system and component."""
        return (self.vehicle.system, self.vehicle.component) if self.vehicle else None

    def follows(self, message: Message) -> bool:
        """Whether it is the heartbeat of the vehicle, or while there is none, of a vehicle that can be followed."""
        if not from_autopilot(message):
            return False
        heard = self._described(message)
        if self.vehicle is not None:
            return heard == self.vehicle
        return bool(heard.firmware) and self.system in (None, heard.system)

    def meet(self, message: Message) -> bool:
        """Takes note of who sent a heartbeat; whether that is the vehicle from now on."""
        self.overhear(message)
        if self.vehicle is not None or not self.follows(message):
            return False
        self.vehicle, self.firmware = self._described(message), self._firmwares[message.autopilot]
        return True

    def overhear(self, message: Message) -> None:
        """Takes note of a sender that is not followed, such as at another address."""
        if not from_autopilot(message) or self.ids == sender_of(message):
            return
        heard = self._described(message)
        self._heard[heard.system] = heard
        if self._others():
            self._tell_once("another-vehicle", f"{self._others()[0]} is on the link too: it is ignored")

    def believes(self, message: Message, now_s: float) -> bool:
        """Whether a message with the followed ids is the vehicle's own."""
        if message.get_type() == "HEARTBEAT" and (heard := self._described(message)) != self.vehicle:
            if not _is_booting(message):
                self._tell_once(
                    "another-program",
                    f"another program sends heartbeats with this vehicle's ids, {heard}: they are ignored; give that "
                    "program a component id of its own",
                )
            return False
        self._twins.take(message, now_s)
        if self._twins.evidence:
            self._tell_once("same-id", self._twins_problem())
        return True

    @property
    def doubt(self) -> str:
        """Why it is not certain which vehicle is followed, and what to do; empty where it is."""
        if self._twins.evidence:
            return self._twins_problem()
        if not self._others():
            return ""
        assert self.vehicle is not None  # noqa: S101 - or there were no others
        heard = sorted((self.vehicle, *self._others()), key=lambda each: each.system)
        return (
            f"several vehicles are on the link: {'; '.join(map(str, heard))}; say which one is flown, with "
            f"{' or '.join(f'system = {each.system}' for each in heard)} in [autopilot]"
        )

    @property
    def is_unflyable(self) -> bool:
        """Whether the system in question is a vehicle that cannot be flown."""
        heard = self._in_question()
        return heard is not None and heard.is_vehicle and not heard.firmware

    def heard_instead(self, connection: str) -> str:
        """Which autopilots sent heartbeats instead of the vehicle; empty if none did."""
        heard = self._in_question()
        if heard is not None and not heard.firmware:
            return (
                f"{name_of('MAV_AUTOPILOT', heard.autopilot)} with {name_of('MAV_TYPE', heard.type)} was heard on "
                f"{connection}, as system {heard.system}; only multicopters with "
                f"{' or '.join(each.name for each in self._firmwares.values())} can be flown"
            )
        if not self._heard:
            return ""
        others = ", ".join(f"{each.system} ({each.runs})" for each in self._heard.values())
        return f"system {self.system} was not heard on {connection}; heard: {others}"

    def _in_question(self) -> Heard | None:
        """The configured system, or without it the first autopilot; None before its heartbeat."""
        if self.system is not None:
            return self._heard.get(self.system)
        return next(iter(self._heard.values()), None)

    def _described(self, message: Message) -> Heard:
        firmware = self._firmwares.get(message.autopilot) if message.type in _COPTERS else None
        return Heard(*sender_of(message), message.autopilot, message.type, firmware.name if firmware else "")

    def _others(self) -> list[Heard]:
        """The vehicles of other systems; empty if the configuration names the system."""
        if self.system is not None or self.vehicle is None:
            return []
        return [
            each for each in self._heard.values() if each.system != self.vehicle.system and each.is_vehicle
        ]

    def _twins_problem(self) -> str:
        assert self.vehicle is not None  # noqa: S101
        return (
            f"two vehicles with system {self.vehicle.system} are on the link ({self._twins.evidence}): give one of "
            "them another id (SYSID_THISMAV or MAV_SYSID of ArduPilot, MAV_SYS_ID of PX4), or switch it off"
        )

    def _tell_once(self, kind: LinkTroubleName, why: str) -> None:
        if kind not in self._told:
            self._told.add(kind)
            self._tell(LinkTrouble(kind, why))


def _is_booting(message: Message) -> bool:
    """An ArduPilot that starts says its type once it knows its motors."""
    return bool(message.autopilot in _AUTOPILOTS and message.type == mavlink.MAV_TYPE_GENERIC)


def sender_of(message: Message) -> tuple[int, int]:
    """Its system and component."""
    return message.get_srcSystem(), message.get_srcComponent()
