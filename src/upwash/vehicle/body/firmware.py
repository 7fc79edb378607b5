"""What a stand-in's connections need of an autopilot: what it reports and obeys, and what it says by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol, TypeAlias

from upwash.vehicle.body.condition import FaultKind
from upwash.vehicle.body.parameters import Parameter

Message: TypeAlias = Any  # pymavlink's messages are not typed
Report: TypeAlias = Callable[[float], Message | None]


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


@dataclass(frozen=True, slots=True)
class Reply:
    """The results (MAV_RESULT) of a command, each to be acknowledged, and what is said about it to whom."""

    results: tuple[int, ...] = ()
    to_sender: tuple[Message, ...] = ()
    to_all: tuple[Message, ...] = ()


NOTHING = Reply()


class ParameterTable(Protocol):
    """Its parameters, with the values as PARAM_VALUE holds them."""

    def __len__(self) -> int: ...

    def named(self, name: str) -> Parameter | None:
        """The parameter of that name, if there is one."""

    def at(self, index: int) -> Parameter | None:
        """The parameter at that place, if there is one."""


class Flown(Protocol):
    """What a firmware flies: it has parameters, and things go wrong with it."""

    @property
    def parameters(self) -> ParameterTable:
        """Its parameters."""

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""


class StandInFirmware(Protocol):
    """An autopilot between two messages; time is an argument everywhere."""

    @property
    def copter(self) -> Flown:
        """What it flies."""

    @property
    def reports(self) -> Mapping[float, Report]:
        """What can be asked for, by message number; a request's number arrives as a float."""

    @property
    def stream_groups(self) -> Mapping[int, tuple[int, ...]]:
        """The messages of each group of REQUEST_DATA_STREAM."""

    @property
    def unasked_s(self) -> Mapping[int, float]:
        """The messages that it sends to everyone without being asked, with their intervals."""

    @property
    def told_of_home(self) -> tuple[int, ...]:
        """The messages that answer the question for its home."""

    @property
    def wakes_every_s(self) -> float:
        """How often it looks whether it has something to say."""

    @property
    def texts_only_to_ground_stations(self) -> bool:
        """Whether STATUSTEXT is only sent to those from whom a ground station's heartbeats come."""

    def live(self, now_s: float) -> Iterable[Message]:
        """What it says to everyone by itself since it was last asked."""

    def obey(self, now_s: float, message: Message) -> Reply:
        """Does what a COMMAND_LONG or COMMAND_INT tells it, if it can."""

    def requested(self, now_s: float, message: Message) -> Iterable[Message]:
        """The reports that a REQUEST_MESSAGE asks for; none if it has no such reports now."""

    def hear(self, now_s: float, message: Message) -> Reply:
        """Takes any other message."""

    def set_parameter(self, now_s: float, name: str, value: float) -> Iterable[Message]:
        """Changes a parameter if it has it and the value fits; returns what everyone is told about it."""


def asked_by_number(reports: Mapping[float, Report], now_s: float, number: float) -> tuple[Message, ...]:
    """The report of that number as it is now, if there is one."""
    report = reports.get(number)
    message = report(now_s) if report else None
    return () if message is None else (message,)
