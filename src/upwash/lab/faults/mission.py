"""Missions that know what each of their calls must answer, and the services that they call.

Each call asks about a number of its own. What came of it the mission tells its user, so that it is in the event
log; some numbers make the service raise an exception of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from upwash.core.geo import Waypoint
from upwash.drone.api import Drone
from upwash.rpc.service import service

Mode = Literal["light", "heavy"]


class Blurred(Exception):
    """The number has no answer."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """The answer for a number."""

    number: int
    mode: Mode
    digits: list[int]


class CallReport(msgspec.Struct, frozen=True, kw_only=True):
    """What came of the call with that number, as the mission tells its user."""

    asked: int
    answer: Any = None
    raised: str = ""


class ActionReport(msgspec.Struct, frozen=True, kw_only=True):
    """What the answer of that number demanded is done, as the mission tells its user, where the drone is."""

    done: int


@service(profile_by="mode")
class Spotter:
    """Reads the digits of a number, except of every fifth number."""

    def look(self, number: int, mode: Mode) -> Sighting:
        """Slow or fast, by the mode."""
        if number % 5 == 2:
            raise Blurred(f"number {number} is blurred")
        return Sighting(number, mode, [int(digit) for digit in str(number)])


@service
class Gauge:
    """Squares a number, except every seventh number."""

    def read(self, number: int) -> int:
        """Always takes as long."""
        if number % 7 == 3:
            raise ValueError("there is no square of", number)
        return number * number


def look(drone: Drone, mode: Mode) -> None:
    """Has one number looked at, at each waypoint."""
    spotter = drone.service(Spotter)
    _survey(drone, lambda number: spotter.look(number, mode), calls=1)


def look_and_read(drone: Drone, mode: Mode) -> None:
    """Calls both services at each waypoint."""
    spotter, gauge = drone.service(Spotter), drone.service(Gauge)

    def ask(number: int) -> object:
        return gauge.read(number) if number % 2 else spotter.look(number, mode)

    _survey(drone, ask, calls=2)


def look_later(drone: Drone, mode: Mode) -> None:
    """Has one number looked at, at each waypoint, and may fly on meanwhile; some answers demand an action there."""
    spotter = drone.service(Spotter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for number, waypoint in enumerate(drone.plan):
        drone.autopilot.goto(waypoint)
        drone.camera.take_photo()
        visit = _Visit(drone, waypoint, number)
        pending = drone.start(spotter.look, number, mode)
        drone.stay_or_go(pending, visit.act, demands=visit.demands, failed=visit.fail)
    drone.end_flight()
    drone.autopilot.disarm()


def demands_something(number: int) -> bool:
    """Whether the answer demands an action at its waypoint, or the call raises."""
    return number % 3 == 0 or number % 5 == 2


@dataclass(frozen=True, slots=True)
class _Visit:
    """The answer of one waypoint, which arrives before or after the drone leaves it."""

    drone: Drone
    waypoint: Waypoint
    number: int

    def demands(self, sighting: Sighting) -> bool:
        """Tells the user at once, wherever the drone is."""
        self._tell(CallReport(asked=self.number, answer=msgspec.to_builtins(sighting)))
        return demands_something(self.number)

    def act(self, _: Sighting) -> None:
        self.drone.user.notify(ActionReport(done=self.number), at=self.drone.autopilot.position)

    def fail(self, error: Exception) -> None:
        if not isinstance(error, Blurred):
            raise error
        self._tell(CallReport(asked=self.number, raised=repr(error)))
        self.drone.user.notify(ActionReport(done=self.number), at=self.drone.autopilot.position)

    def _tell(self, heard: CallReport) -> None:
        self.drone.user.notify(heard, at=self.waypoint)


def expected(program: str, mode: Mode, number: int) -> CallReport:
    """What a mission of this module must hear when it asks about the number."""
    both = program.endswith(":look_and_read")
    ask: Callable[[], object] = (
        (lambda: Gauge().read(number)) if both and number % 2 else (lambda: Spotter().look(number, mode))
    )
    return _hear(number, ask)


def _survey(drone: Drone, ask: Callable[[int], object], *, calls: int) -> None:
    numbers = itertools.count()
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.camera.take_photo()
        for _ in range(calls):
            _tell(drone, waypoint, next(numbers), ask)
    drone.end_flight()
    drone.autopilot.disarm()


def _tell(drone: Drone, waypoint: Waypoint, number: int, ask: Callable[[int], object]) -> None:
    drone.user.notify(_hear(number, lambda: ask(number)), at=waypoint)


def _hear(number: int, ask: Callable[[], object]) -> CallReport:
    try:
        answer = ask()
    except (Blurred, ValueError) as error:
        return CallReport(asked=number, raised=repr(error))
    return CallReport(asked=number, answer=msgspec.to_builtins(answer))
