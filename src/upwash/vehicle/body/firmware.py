"""An autopilot between two messages: what it answers and says by itself. Time is an argument everywhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Position
from upwash.mavlink.packets import Message
from upwash.vehicle.body.copter import Multicopter, Result
from upwash.vehicle.body.fence import FenceTransfer

Report: TypeAlias = Callable[[float], Message | tuple[Message, ...] | None]
AnyCopter = TypeVar("AnyCopter", bound=Multicopter)

_ABOVE_SEA = mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT
_ABOVE_HOME = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """COMMAND_LONG and COMMAND_INT alike; `place` is parameters 5 to 7: degrees, and metres in the frame."""

    number: int
    parameters: tuple[float, float, float, float]
    place: tuple[float, float, float]
    frame: int
    shoots: bool = False  # parameter 5, as DO_DIGICAM_CONTROL means it


Handler: TypeAlias = Callable[[Any, float, VehicleCommand], Result]


def read_command(message: Message) -> VehicleCommand:
    """The command in either message."""
    parameters = message.param1, message.param2, message.param3, message.param4
    if message.get_type() == "COMMAND_INT":
        place = message.x / 1e7, message.y / 1e7, message.z
        return VehicleCommand(message.command, parameters, place, message.frame, shoots=message.x == 1)
    place = message.param5, message.param6, message.param7
    frame = mavlink.MAV_FRAME_GLOBAL
    return VehicleCommand(message.command, parameters, place, frame, shoots=message.param5 == 1)


def position_in_frame(
    copter: Multicopter, frame: int, place: tuple[float, float, float], *, home_m: float
) -> Position | None:
    """The position of a latitude, a longitude and an altitude; None in an unknown frame or outside the Earth.

    In some frames altitudes count from home, which is `home_m` above the ground at boot.
    """
    latitude_deg, longitude_deg, altitude_m = place
    if frame in _ABOVE_SEA:
        altitude_m -= copter.settings.home_altitude_m
    elif frame in _ABOVE_HOME:
        altitude_m += home_m
    else:
        return None
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        return None
    return copter.frame.position(GeoPosition(latitude_deg, longitude_deg, altitude_m))


class StandInFirmware(ABC, Generic[AnyCopter]):
    """What a stand-in's connections need of an autopilot."""

    stream_groups: Mapping[int, tuple[int, ...]] = {}
    """The messages in each group of REQUEST_DATA_STREAM."""
    unasked_s: ClassVar[Mapping[int, float]]
    """The messages that it sends to everyone without being asked, with their intervals."""
    told_of_home: tuple[int, ...]
    """The messages that answer the question for its home."""
    wakes_every_s: float
    """How often it looks whether it has something to say."""
    texts_only_to_ground_stations = False
    """Whether STATUSTEXT is only sent to peers that send a ground station's heartbeats."""

    listeners: ClassVar[Mapping[str, Callable[..., Iterable[Message] | None]]]
    """The methods that take messages, by their kind. All others are about its fence."""

    def __init__(self, copter: AnyCopter, reports: Mapping[float, Report], fence: FenceTransfer) -> None:
        self.copter = copter
        self._fence = fence
        self.reports = reports  # by message number; a request's number arrives as a float

    def report(self, now_s: float, number: float) -> tuple[Message, ...]:
        """The present report of that number; empty if it has none now."""
        self.copter.advance(now_s)
        report = self.reports.get(number)
        told = report(now_s) if report else None
        if isinstance(told, tuple):
            return told
        return () if told is None else (told,)

    def update_of(self, now_s: float, number: float) -> object:
        """The present update of a report that is sent once for each update; None for reports at fixed intervals."""
        return None

    def requested(self, now_s: float, message: Message) -> Iterable[Message]:
        """The reports that a REQUEST_MESSAGE asks for; none if it has no such reports now."""
        return self.report(now_s, message.param1)

    @abstractmethod
    def live(self, now_s: float) -> Iterable[Message]:
        """What it does by itself; the messages for everyone since then."""

    @abstractmethod
    def said(self) -> Iterable[Message]:
        """The messages for everyone since it was last asked."""

    @abstractmethod
    def obey(self, now_s: float, message: Message) -> tuple[int, ...]:
        """Carries out a COMMAND_LONG or COMMAND_INT as far as it can; returns each MAV_RESULT to be acknowledged."""

    def hear(self, now_s: float, message: Message) -> Iterable[Message]:
        """Takes any other message; returns the answers for its sender."""
        self.copter.advance(now_s)
        listener = self.listeners.get(message.get_type())
        return (listener(self, now_s, message) or ()) if listener else self._fence.hear(now_s, message)

    def set_parameter(self, now_s: float, name: str, value: float) -> Iterable[Message]:
        """Changes a parameter if it has it and the value fits; returns the messages to everyone about it."""
        self.copter.parameters.receive(name, value)
        return ()


def arming(arms_anyway: int, disarms_anyway: int) -> Handler:
    """What MAV_CMD_COMPONENT_ARM_DISARM does, where those numbers override the vehicle's objections."""

    def obey(copter: Multicopter, now_s: float, command: VehicleCommand) -> Result:
        wish, magic = command.parameters[:2]
        if wish == 1:
            return copter.arm(now_s, forced=magic == arms_anyway)
        return copter.disarm(now_s, forced=magic == disarms_anyway) if wish == 0 else Result.UNSUPPORTED

    return obey
