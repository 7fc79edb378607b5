"""An autopilot between two messages: what it answers and says by itself. Time is an argument everywhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Position
from upwash.vehicle.body.copter import Multicopter

Message: TypeAlias = Any  # pymavlink's messages are not typed
Report: TypeAlias = Callable[[float], Message | None]
AnyCopter = TypeVar("AnyCopter", bound=Multicopter)

_ABOVE_SEA = mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT
_ABOVE_HOME = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(frozen=True, slots=True)
class CommandReply:
    """The MAV_RESULTs of a command, each to be acknowledged, and the messages for its sender or for all."""

    results: tuple[int, ...] = ()
    to_sender: tuple[Message, ...] = ()
    to_all: tuple[Message, ...] = ()


NOTHING = CommandReply()


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """COMMAND_LONG and COMMAND_INT alike; `place` is parameters 5 to 7: degrees, and metres in the frame."""

    number: int
    parameters: tuple[float, float, float, float]
    place: tuple[float, float, float]
    frame: int
    shoots: bool = False  # parameter 5, as DO_DIGICAM_CONTROL means it


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


def sender_of(message: Message) -> tuple[int, int]:
    """The system and the component that sent the message."""
    return message.get_srcSystem(), message.get_srcComponent()


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

    def __init__(self, copter: AnyCopter, reports: Mapping[float, Report]) -> None:
        self.copter = copter
        self.reports = reports  # by message number; a request's number arrives as a float

    def report(self, now_s: float, number: float) -> tuple[Message, ...]:
        """The present report of that number; empty if it has none now."""
        self.copter.advance(now_s)
        report = self.reports.get(number)
        message = report(now_s) if report else None
        return () if message is None else (message,)

    def requested(self, now_s: float, message: Message) -> Iterable[Message]:
        """The reports that a REQUEST_MESSAGE asks for; none if it has no such reports now."""
        return self.report(now_s, message.param1)

    @abstractmethod
    def live(self, now_s: float) -> Iterable[Message]:
        """The messages for everyone since it was last asked."""

    @abstractmethod
    def obey(self, now_s: float, message: Message) -> CommandReply:
        """Carries out a COMMAND_LONG or COMMAND_INT as far as it can."""

    @abstractmethod
    def hear(self, now_s: float, message: Message) -> CommandReply:
        """Takes any other message."""

    def set_parameter(self, now_s: float, name: str, value: float) -> Iterable[Message]:
        """Changes a parameter if it has it and the value fits; returns the messages to everyone about it."""
        self.copter.parameters.receive(name, value)
        return ()
