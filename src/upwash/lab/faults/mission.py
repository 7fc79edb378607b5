"""Missions that know what each of their calls must answer, and the services that they call.

Each call asks about a number of its own. What came of it the mission tells its user, so that it is in the event
log; some numbers make the service raise an exception of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from upwash.core.geo import Position, Waypoint
from upwash.drone.api import Drone
from upwash.drone.pending import Pending
from upwash.rpc.service import service

Mode = Literal["light", "heavy"]
_PICTURE = bytes(64)


class Blurred(Exception):
    """The number has no answer."""


@dataclass(frozen=True, slots=True)
class NumberRead:
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


@service
class Thumbnail:
    """Makes pictures smaller, except of six numbers in a row of each ten."""

    def look(self, number: int, picture: bytes) -> tuple[int, bytes]:
        """Raises, or makes more of it, where it fails."""
        match number % 10:
            case 1 | 3 | 5 | 6:
                raise Blurred(f"number {number} has no smaller picture")
            case 2 | 4:
                return number, picture * 2
        return number, picture[:8]


@service(profile_by="mode", before_sending=Thumbnail)
class Spotter:
    """Reads the digits of a number, except of every fifth number."""

    def look(self, number: int, mode: Mode, picture: bytes = _PICTURE) -> NumberRead:
        """Slow or fast, by the mode."""
        if number % 5 == 2:
            raise Blurred(f"number {number} is blurred")
        return NumberRead(number, mode, [int(digit) for digit in str(number)])


@service
class Gauge:
    """Squares a number, except every seventh number."""

    def read(self, number: int) -> int:
        """Always takes as long."""
        if number % 7 == 3:
            raise ValueError("there is no square of", number)
        return number * number


HASTY_S = 12.0  # the deadline of some calls that only servers compute


@service(where="servers")
class Surveyor:
    """Doubles a number, except every fifth number; no drone can run it."""

    def survey(self, number: int) -> int:
        """Always takes as long."""
        if number % 5 == 2:
            raise ValueError("there is no double of", number)
        return 2 * number


def ask_servers(drone: Drone, mode: Mode) -> None:
    """Asks servers about a number at each waypoint, and goes on; waits for some calls, and gives some a deadline."""
    patient = drone.service(Surveyor, unanswered=None)
    hasty = drone.service(Surveyor, unanswered=None, within_s=HASTY_S)
    for number, waypoint in visits(drone):
        drone.camera.take_photo()
        surveyor = hasty if is_hasty(number) else patient
        if number % 4 == 3:
            answer: int | None = surveyor.survey(number)
            drone.user.notify(CallReport(asked=number, answer=answer), at=waypoint)
            continue
        visit = _Visit(drone, waypoint, number, ask_servers.__name__)
        drone.stay_or_go(drone.start(surveyor.survey, number), visit.act, demands=visit.demands)


def visits(drone: Drone) -> Iterator[tuple[int, Waypoint]]:
    """Flies the plan; each waypoint as the drone arrives there, by its number in the order of the flight."""
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for number, waypoint in enumerate(drone.plan):
        drone.autopilot.goto(waypoint)
        yield number, waypoint
    drone.end_flight()
    drone.autopilot.disarm()


def is_hasty(number: int) -> bool:
    """Whether the call about the number has a deadline."""
    return number % 3 == 1


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


def look_later(drone: Drone, mode: Mode, *, program: str = "look_later") -> None:
    """Has one number looked at, at each waypoint, and may fly on meanwhile; some answers demand an action there."""
    spotter = drone.service(Spotter)
    for number, waypoint in visits(drone):
        drone.camera.take_photo()
        visit = _Visit(drone, waypoint, number, program)
        pending = drone.start(spotter.look, number, mode)
        drone.stay_or_go(pending, visit.act, demands=visit.demands, failed=visit.fail)


def look_twice_later(drone: Drone, mode: Mode) -> None:
    """The same with two answers, whose demands differ."""
    look_later(drone, mode, program=look_twice_later.__name__)


def look_on_the_move(drone: Drone, mode: Mode) -> None:
    """Starts a call at each waypoint of its rows; hovers, waits for a call or leaves the row at some."""
    _look_on_the_move(drone, mode, gauge=None, program=look_on_the_move.__name__)


def look_twice_on_the_move(drone: Drone, mode: Mode) -> None:
    """The same with two answers, whose demands differ."""
    _look_on_the_move(drone, mode, gauge=None, program=look_twice_on_the_move.__name__)


def look_and_read_on_the_move(drone: Drone, mode: Mode) -> None:
    """The same with both services in turn."""
    _look_on_the_move(drone, mode, gauge=drone.service(Gauge), program=look_and_read_on_the_move.__name__)


def _look_on_the_move(drone: Drone, mode: Mode, *, gauge: Gauge | None, program: str) -> None:
    spotter = drone.service(Spotter)

    def ask(number: int) -> object:
        return gauge.read(number) if gauge is not None and number % 2 else spotter.look(number, mode)

    for number, waypoint in visits(drone):
        if number % 7 == 5:
            drone.autopilot.hover(1.0)
        drone.camera.take_photo()
        if is_waited_for(program, number):
            _tell(drone, waypoint, number, ask)
            continue
        visit = _Visit(drone, waypoint, number, program)
        pending: Pending[Any] = (
            drone.start(gauge.read, number)
            if gauge is not None and number % 2
            else drone.start(spotter.look, number, mode)
        )
        drone.stay_or_go(pending, visit.act, demands=visit.demands, failed=visit.fail)
        if number % 11 == 8:
            drone.autopilot.goto(Position(5.0, 5.0, drone.altitude_m))


def is_waited_for(program: str, number: int) -> bool:
    """Whether the mission waits for the call at once."""
    return not program.endswith(("_later", "_on_the_move")) or (
        program.endswith("_on_the_move") and number % 4 == 3
    )


def demands_something(program: str, number: int, mode: str = "heavy") -> bool:
    """Whether the answer of that mode demands an action at its waypoint, or the call raises.

    With two answers both demand one at every fourth waypoint, only the better one at the next, and only the first one
    at the one after it.
    """
    if is_waited_for(program, number):
        return False
    if "look_twice" in program:
        demanding: tuple[str, ...] = (("light", "heavy"), ("heavy",), ("light",), ())[number % 4]
        return mode in demanding or bool(expected(program, "light", number).raised)
    often = program.endswith("look_later")
    return (number % 3 == 0 if often else number % 6 == 4) or bool(expected(program, "light", number).raised)


@dataclass(frozen=True, slots=True)
class _Visit:
    """The answer of one waypoint, which arrives before or after the drone leaves it."""

    drone: Drone
    waypoint: Waypoint
    number: int
    program: str

    def demands(self, answer: object) -> bool:
        """Tells the user at once, wherever the drone is."""
        self._tell(CallReport(asked=self.number, answer=msgspec.to_builtins(answer)))
        if self.program == ask_servers.__name__:
            return answer is not None and self.number % 6 == 4
        mode = answer.mode if isinstance(answer, NumberRead) else ""
        return demands_something(self.program, self.number, mode)

    def act(self, _: object) -> None:
        self.drone.user.notify(ActionReport(done=self.number), at=self.drone.autopilot.position)

    def fail(self, error: Exception) -> None:
        if not isinstance(error, (Blurred, ValueError)):
            raise error
        self._tell(CallReport(asked=self.number, raised=repr(error)))
        self.act(None)

    def _tell(self, heard: CallReport) -> None:
        self.drone.user.notify(heard, at=self.waypoint)


def expected(program: str, mode: Mode, number: int) -> CallReport:
    """What a mission of this module must hear when it asks about the number."""
    both = "look_and_read" in program
    ask: Callable[[], object] = (
        (lambda: Gauge().read(number)) if both and number % 2 else (lambda: Spotter().look(number, mode))
    )
    return _hear(number, ask)


def _survey(drone: Drone, ask: Callable[[int], object], *, calls: int) -> None:
    numbers = itertools.count()
    for _, waypoint in visits(drone):
        drone.camera.take_photo()
        for _ in range(calls):
            _tell(drone, waypoint, next(numbers), ask)


def _tell(drone: Drone, waypoint: Waypoint, number: int, ask: Callable[[int], object]) -> None:
    drone.user.notify(_hear(number, lambda: ask(number)), at=waypoint)


def _hear(number: int, ask: Callable[[], object]) -> CallReport:
    try:
        answer = ask()
    except (Blurred, ValueError) as error:
        return CallReport(asked=number, raised=repr(error))
    return CallReport(asked=number, answer=msgspec.to_builtins(answer))
