"""Which autopilot on a link is the followed vehicle, and the wait for it.

The evidence, and what it means:

- A heartbeat of component 1 that names ArduPilot or PX4 and the type of a vehicle is an autopilot's. Gimbals,
  cameras, ground stations and companion computers have other types or no autopilot, and never count.
- Flown are the types that name a multicopter by its rotors, three or more. Rotors of a helicopter, coaxial ones too,
  run up before a take-off and are steered otherwise. A generic multirotor is a type that neither autopilot reports
  of a multicopter: PX4 does not even fly it as one.
- Two systems with an autopilot are two vehicles. The configuration has to name the vehicle to fly.
- A heartbeat with the followed ids and another autopilot or type is another program's, and is ignored.
- Two vehicles with one system id are known by what one vehicle cannot report (`twins`).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotError, AutopilotNotHeard
from upwash.mavlink.packets import Message, name_of, sender_of
from upwash.mavlink.signing import SignatureRefusal
from upwash.real.mavlink.link import MavlinkLink
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.receiver import from_autopilot
from upwash.real.mavlink.telemetry import FirmwareProfile
from upwash.real.mavlink.twins import Twins

_COPTERS = (
    mavlink.MAV_TYPE_TRICOPTER, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_DECAROTOR, mavlink.MAV_TYPE_DODECAROTOR,
)  # fmt: skip
_OTHER_VEHICLES = (
    mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_TYPE_AIRSHIP, mavlink.MAV_TYPE_FREE_BALLOON,
    mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT, mavlink.MAV_TYPE_SUBMARINE,
    mavlink.MAV_TYPE_VTOL_DUOROTOR, mavlink.MAV_TYPE_VTOL_QUADROTOR, mavlink.MAV_TYPE_VTOL_TILTROTOR,
    mavlink.MAV_TYPE_VTOL_RESERVED2, mavlink.MAV_TYPE_VTOL_RESERVED3, mavlink.MAV_TYPE_VTOL_RESERVED4,
    mavlink.MAV_TYPE_GENERIC_MULTIROTOR, mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_TYPE_HELICOPTER,
)  # fmt: skip
_AUTOPILOTS = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}

_LOOKED_EACH_S = 1.0
_RULE = "of a type that names three rotors or more: no helicopter, no coaxial or generic type"
_MOST_SENDERS = 8  # that are named
_DEFINITE_S = 10.0  # the wait for the vehicle ends this long after the first heartbeat of a wrong vehicle
_TOLD_AFTER_S, _TOLD_EACH_S = 3.0, 15.0
_REMEDIES = {
    SignatureRefusal.UNSIGNED: "give it the key with a ground station, or leave autopilot.signing_key out",
    SignatureRefusal.OTHER_KEY: "give it the key of autopilot.signing_key with a ground station, "
    "or name the file of its key",
    SignatureRefusal.STALE: "wait until its GPS has a fix, and see that this computer's clock is right",
    SignatureRefusal.REPLAYED: "somebody repeats what it said earlier, or it was started anew: try again",
}


@dataclass(frozen=True, slots=True)
class AutopilotInfo:
    """An autopilot as its heartbeat describes it; `firmware` is "" if it cannot be flown."""

    system: int
    component: int
    autopilot: int  # MAV_AUTOPILOT
    type: int  # MAV_TYPE
    firmware: str = ""

    @property
    def kind(self) -> str:
        """The vehicle's type in words, such as "quadrotor"."""
        return _kind_of(self.type)

    @property
    def is_vehicle(self) -> bool:
        """Whether the autopilot is a vehicle's; antenna trackers and the like have autopilots too."""
        return self.autopilot in _AUTOPILOTS and self.type in (*_COPTERS, *_OTHER_VEHICLES)

    @property
    def runs(self) -> str:
        """The firmware and type, such as "ArduCopter quadrotor"."""
        runs = self.firmware or _AUTOPILOTS.get(self.autopilot) or name_of("MAV_AUTOPILOT", self.autopilot)
        return f"{runs} {self.kind}"

    def __str__(self) -> str:
        return f"system {self.system}, component {self.component} ({self.runs})"


def _kind_of(number: int) -> str:
    return name_of("MAV_TYPE", number).removeprefix("MAV_TYPE_").replace("_", " ").lower()


class Identity:
    """Recognizes the followed vehicle: the one with that `system`, or without `system` the only vehicle.

    `firmwares` can be flown. `news` get what a person should know about others on the link, once for each kind.
    """

    def __init__(
        self,
        firmwares: Sequence[FirmwareProfile],
        *,
        system: int | None = None,
        news: VehicleNewsFeed,
    ) -> None:
        self.firmware = firmwares[0]
        self.vehicle: AutopilotInfo | None = None
        self.system = system
        self._firmwares = {firmware.autopilot: firmware for firmware in firmwares}
        self._news = news
        self._heard: dict[int, AutopilotInfo] = {}  # by system
        self._senders: dict[tuple[int, int], str] = {}  # of no autopilot's heartbeat: what they sent
        self.twins = Twins()

    @property
    def ids(self) -> tuple[int, int] | None:
        """The followed system and component."""
        return (self.vehicle.system, self.vehicle.component) if self.vehicle else None

    def follows(self, message: Message) -> bool:
        """Whether the message is a heartbeat of the vehicle or, while none is followed, of a vehicle that can be."""
        if not from_autopilot(message):
            return False
        sender = self._described(message)
        if self.vehicle is not None:
            return sender == self.vehicle
        return bool(sender.firmware) and self.system in (None, sender.system)

    def meet(self, message: Message) -> bool:
        """Note the sender of a heartbeat; return whether it became the followed vehicle."""
        self.overhear(message)
        if self.vehicle is not None or not self.follows(message):
            return False
        self.vehicle, self.firmware = self._described(message), self._firmwares[message.autopilot]
        return True

    def overhear(self, message: Message) -> None:
        """Note the sender of a message that is not followed, for example at another address."""
        if not from_autopilot(message):
            self._note_sender(message)
            return
        if self.ids == sender_of(message):
            return
        sender = self._described(message)
        self._heard[sender.system] = sender
        if self._others():
            self._news.once("another-vehicle", f"{self._others()[0]} is on the link too: it is ignored")

    def _note_sender(self, message: Message) -> None:
        """Note what another sender sent, its heartbeat before all else, until the vehicle is found."""
        sender, kind = sender_of(message), message.get_type()
        if self.vehicle is not None or (sender not in self._senders and len(self._senders) == _MOST_SENDERS):
            return
        if kind == "HEARTBEAT":
            self._senders[sender] = _kind_of(message.type)
        else:
            self._senders.setdefault(sender, kind)

    def believes(self, message: Message, now_s: float) -> bool:
        """Whether a message with the followed ids is the vehicle's own."""
        if message.get_type() == "HEARTBEAT" and (sender := self._described(message)) != self.vehicle:
            # An ArduPilot that starts reports its type once it knows its motors.
            if message.autopilot not in _AUTOPILOTS or message.type != mavlink.MAV_TYPE_GENERIC:
                self._news.once(
                    "another-program",
                    f"another program sends heartbeats with this vehicle's ids, {sender}: they are ignored; give "
                    "that program a component id of its own",
                )
            return False
        self.twins.take(message, now_s)
        if self.two_with_one_id:
            self._news.once("same-id", self.two_with_one_id)
        return True

    @property
    def two_with_one_id(self) -> str:
        """What shows that two vehicles send with the followed ids, and what to do; "" if nothing does."""
        if self.vehicle is None or not self.twins.evidence:
            return ""
        return (
            f"two vehicles with system {self.vehicle.system} are on the link ({self.twins.evidence}): give one of "
            "them another id (SYSID_THISMAV or MAV_SYSID of ArduPilot, MAV_SYS_ID of PX4), or switch it off"
        )

    @property
    def doubt(self) -> str:
        """Why it is uncertain which vehicle is followed, and what to do; "" if it is certain."""
        if self.two_with_one_id:
            return self.two_with_one_id
        if self.vehicle is None or not self._others():
            return ""
        vehicles = sorted((self.vehicle, *self._others()), key=lambda vehicle: vehicle.system)
        return (
            f"several vehicles are on the link: {'; '.join(map(str, vehicles))}; say which one is flown, with "
            f"{' or '.join(f'system = {vehicle.system}' for vehicle in vehicles)} in [autopilot]"
        )

    @property
    def is_unflyable(self) -> bool:
        """Whether the system in question is a vehicle that cannot be flown."""
        candidate = self._in_question()
        return candidate is not None and candidate.is_vehicle and not candidate.firmware

    def heard_instead(self, connection: str) -> str:
        """Which autopilots sent heartbeats instead of the vehicle; empty if none did."""
        candidate = self._in_question()
        if candidate is not None and not candidate.firmware:
            return (
                f"{name_of('MAV_AUTOPILOT', candidate.autopilot)} with {name_of('MAV_TYPE', candidate.type)} was "
                f"heard on {connection}, as system {candidate.system}; only multicopters with "
                f"{' or '.join(firmware.name for firmware in self._firmwares.values())} can be flown, {_RULE}"
            )
        if not self._heard and not self._senders:
            return ""
        vehicle = "no autopilot was" if self.system is None else f"system {self.system} was not"
        others = [f"{other.system} ({other.runs})" for other in self._heard.values()]
        others += [
            f"system {system}, component {part} ({what})" for (system, part), what in self._senders.items()
        ]
        return f"{vehicle} heard on {connection}; heard: {', '.join(others)}"

    def _in_question(self) -> AutopilotInfo | None:
        """The configured system, or without it the first autopilot; None before its heartbeat."""
        if self.system is not None:
            return self._heard.get(self.system)
        return next(iter(self._heard.values()), None)

    def _described(self, message: Message) -> AutopilotInfo:
        firmware = self._firmwares.get(message.autopilot) if message.type in _COPTERS else None
        name = firmware.name if firmware else ""
        return AutopilotInfo(*sender_of(message), message.autopilot, message.type, name)

    def _others(self) -> list[AutopilotInfo]:
        """The vehicles of other systems; empty if the configuration names the system."""
        if self.system is not None or self.vehicle is None:
            return []
        return [
            other
            for other in self._heard.values()
            if other.system != self.vehicle.system and other.is_vehicle
        ]


async def first_heartbeat(
    link: MavlinkLink,
    identity: Identity,
    news: Callable[[], Awaitable[object]],
    *,
    within_s: float,
    waiting: Callable[[str, float], None],
) -> None:
    """Returns after the vehicle's first heartbeat; AutopilotNotHeard without it, AutopilotError for a wrong vehicle.

    `news` returns after a message of the vehicle. `waiting` gets the reason of the wait and its seconds.
    """
    now_s = asyncio.get_running_loop().time
    begun_s, told_s, until_s = now_s(), _TOLD_AFTER_S, within_s
    while identity.vehicle is None:
        waited_s = now_s() - begun_s
        if _is_definite(link, identity):
            until_s = min(until_s, waited_s + _DEFINITE_S)
        if waited_s >= until_s:
            raise _not_found(link, identity, waited_s)
        if waited_s >= told_s:
            told_s += _TOLD_EACH_S
            waiting(_why_waiting(link, identity), waited_s)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(_LOOKED_EACH_S, until_s - waited_s)):
                await news()


def _is_definite(link: MavlinkLink, identity: Identity) -> bool:
    """Whether a longer wait cannot help: a wrong key, or a vehicle that cannot be flown."""
    return link.refused in (SignatureRefusal.UNSIGNED, SignatureRefusal.OTHER_KEY) or identity.is_unflyable


def _why_waiting(link: MavlinkLink, identity: Identity) -> str:
    if link.refused is not None:
        return f"an autopilot was heard on {link.connection}, and its messages {link.refused.value}"
    instead = identity.heard_instead(link.connection)
    return f"{instead or f'no autopilot was heard on {link.connection}'}{link.why_silent}"


def _not_found(link: MavlinkLink, identity: Identity, waited_s: float) -> AutopilotError:
    if link.refused is not None:
        remedy = _REMEDIES[link.refused]
    elif identity.heard_instead(""):
        remedy = f"nothing else came within {waited_s:.0f} s"
        if not identity.is_unflyable:
            remedy += ": check that the vehicle is powered and its messages are passed on"
    else:
        remedy = (
            f"{waited_s:.0f} s were waited: check that it is powered, that the address or device and its speed are "
            "right, and that no other program holds it"
        )
    kind = AutopilotError if _is_definite(link, identity) else AutopilotNotHeard
    return kind("connect", f"{_why_waiting(link, identity)}; {remedy}")
