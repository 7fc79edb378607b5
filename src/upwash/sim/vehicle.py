"""A vehicle on paper: its mode, its motors and how it moves. It obeys every command, whoever it belongs to."""

from __future__ import annotations

import asyncio
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from upwash.core.area_index import AreaIndex
from upwash.core.control import Report
from upwash.core.energy import WayHome
from upwash.core.geo import Circle, Position, Velocity, ground_distance_m
from upwash.vehicle.kinematics import Motion, Phase, elapsed_s

GUIDED, LOITER, RETURN, LAND = "GUIDED", "LOITER", "RTL", "LAND"

_ROUNDING_M = 1e-6
_PAST_THE_BORDER_S = 1e-6
_PILOT_LANDS_AFTER_S = 20.0
_GRAVITY_M_S2 = 9.81


class Manner(Protocol):
    """How a vehicle flies; `vehicle.arducopter` is one."""

    @property
    def returning(self) -> WayHome:
        """How it returns and lands, in numbers that are never too fast."""

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up to the altitude."""

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest."""

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """From the velocity to rest."""

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """How long after its start the vehicle counts as arrived."""

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """From rest to the ground at home."""

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """From rest straight down to the ground."""


class ModelVehicle:
    """Stands on the ground disarmed, or hovers where another program left it.

    `commanded` is told the name of each command that reaches it, `taken` by whom it was taken over, and `moved` each
    motion as it begins. `changed` is set, anew each time, when it begins to move otherwise or its mode or motors
    change by themselves.
    """

    def __init__(
        self,
        ground: Position,
        manner: Manner,
        *,
        hovers_at: Position | None = None,
        commanded: Callable[[str], None] = lambda _: None,
        taken: Callable[[str], None] = lambda _: None,
        moved: Callable[[Motion[Phase]], None] = lambda _: None,
    ) -> None:
        self.mode = GUIDED
        self.armed = hovers_at is not None
        self.changed = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._manner = manner
        self._motion: Motion[Phase] = Motion(0.0, (), hovers_at or ground)
        self._crossings: list[tuple[Sequence[Circle], list[float]]] = []  # of this motion, for each who asked
        self._asked: list[tuple[Sequence[Circle], AreaIndex]] = []  # for, ever
        self._touchdown: asyncio.TimerHandle | None = None  # of a landing by itself or by a person
        self._failsafe = ""
        self._commanded = commanded
        self._taken = taken
        self._moved = moved
        self._moved(self._motion)

    @property
    def position(self) -> Position:
        """Where it is now."""
        return self._motion.position(self._loop.time())

    @property
    def velocity(self) -> Velocity:
        """How it moves now."""
        return self._motion.velocity(self._loop.time())

    @property
    def flies(self) -> bool:
        """Whether it is off the ground."""
        return self.position.altitude_m > 0

    def report(self) -> Report:
        """What its heartbeat says now."""
        return Report(self.mode, self.armed, self._failsafe)

    def obey(self, command: str, *, mode: str | None = None, armed: bool | None = None) -> None:
        """Changes its mode or motors, or neither, by a command of the program."""
        self._commanded(command)
        self.mode = self.mode if mode is None else mode
        if armed is not None:
            self.armed = armed
            self._tell_change()

    def move(self, phases: tuple[Phase, ...], end: Position) -> None:
        """Begins to move, by a command that was obeyed before; `end` is exactly where the phases lead."""
        self._begin(phases, end)
        self._tell_change()

    def settle(self, end: Position) -> None:
        """Rests at the end of a motion: a timer may be a nanosecond early, and the vehicle not quite there."""
        self._begin((), end)

    def _begin(self, phases: tuple[Phase, ...], end: Position) -> None:
        self._motion = Motion(self._loop.time(), phases, end)
        self._moved(self._motion)
        self._crossings.clear()

    # --- what it does without a command ---------------------------------------------------------------------

    def be_taken_by_pilot(self, *, back_after_s: float, before_back: Callable[[], None]) -> None:
        """A person flies it in another mode, later back in the program's if that is before the landing, and lands."""
        self._taken("pilot")
        self.armed = True
        self._change_mode(LOITER)
        if back_after_s < _PILOT_LANDS_AFTER_S:
            self._loop.call_later(back_after_s, self._be_given_back, before_back)
        self._loop.call_later(_PILOT_LANDS_AFTER_S, self._land)

    def fail_safe(self) -> None:
        """Its battery is empty, say: it lands where it is; while it stands disarmed there is nothing to do."""
        if not self.armed:
            return
        self._taken("fail-safe")
        self._failsafe = "Battery Failsafe"
        self._land()

    def fall(self) -> None:
        """Its battery is empty: the motors stop in the air, and it falls straight down."""
        if not self.flies:
            return
        self._taken("fail-safe")
        self._failsafe = "Battery empty"
        self._change_mode(LAND)
        self._come_down(_falling)

    def _be_given_back(self, before_back: Callable[[], None]) -> None:
        before_back()
        self._change_mode(GUIDED)

    def _change_mode(self, mode: str) -> None:
        if self._touchdown is not None:
            self._touchdown.cancel()
        self.mode = mode
        here = self.position
        self.move((), here)

    def _land(self) -> None:
        self._change_mode(LAND)
        self._come_down(self._manner.landing)

    def _come_down(self, way: Callable[[Position], tuple[Phase, ...]]) -> None:
        here = self.position
        ground = Position(here.east_m, here.north_m)
        self.move(way(here) if self.flies else (), ground)
        self._touchdown = self._loop.call_at(self._motion.ends_s, self._touch_down, ground)

    def _touch_down(self, ground: Position) -> None:
        self.settle(ground)
        self.armed = False
        self._tell_change()

    def _tell_change(self) -> None:
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()

    # --- when it crosses borders ----------------------------------------------------------------------------

    def next_crossing_s(self, circles: Sequence[Circle]) -> float | None:
        """Just after its present motion next crosses one of the circles; None where it crosses none."""
        crossings_s = next((times_s for asked, times_s in self._crossings if asked is circles), None)
        if crossings_s is None:
            crossings_s = sorted(self._all_crossings_s(circles))
            self._crossings.append((circles, crossings_s))
        later = bisect_right(crossings_s, self._loop.time())
        return crossings_s[later] if later < len(crossings_s) else None

    def _all_crossings_s(self, circles: Sequence[Circle]) -> Iterator[float]:
        """Just after each time at which the motion crosses one of the circles."""
        phases, begun_s = self._motion.phases, self._motion.begun_s
        if not phases:
            return
        way_m = sum(phase.travelled_m(phase.duration_s) for phase in phases) + _ROUNDING_M
        near = self._index_of(circles).near(phases[0].start, way_m)
        within_reach = [
            each for each in (circles[number] for number in near) if _is_near(phases[0].start, each, way_m)
        ]
        for phase in phases:
            for circle in within_reach:
                for crossing_s in _crossings_s(phase, circle):
                    yield begun_s + crossing_s + _PAST_THE_BORDER_S
            begun_s += phase.duration_s

    def _index_of(self, circles: Sequence[Circle]) -> AreaIndex:
        index = next((index for asked, index in self._asked if asked is circles), None)
        if index is None:
            index = AreaIndex(circles)
            self._asked.append((circles, index))
        return index


def _falling(start: Position) -> tuple[Phase, ...]:
    """From rest to the ground, without the air's resistance."""
    lasts_s = math.sqrt(2 * start.altitude_m / _GRAVITY_M_S2)
    return (Phase(start, Velocity(up_m_s=-1.0), 0.0, _GRAVITY_M_S2, lasts_s),)


def _is_near(place: Position, circle: Circle, within_m: float) -> bool:
    """Whether the circle's border comes so near to the place."""
    return abs(ground_distance_m(place, circle.centre) - circle.radius_m) <= within_m


def _crossings_s(phase: Phase, circle: Circle) -> Iterator[float]:
    """The times from the start of a phase at which it crosses the circle."""
    heading_east, heading_north = phase.heading.east_m_s, phase.heading.north_m_s
    squared = heading_east**2 + heading_north**2
    if squared == 0:
        return
    east_m = phase.start.east_m - circle.centre.east_m
    north_m = phase.start.north_m - circle.centre.north_m
    half = (east_m * heading_east + north_m * heading_north) / squared
    discriminant = half**2 - (east_m**2 + north_m**2 - circle.radius_m**2) / squared
    if discriminant <= 0:
        return
    for travelled_m in (-half - math.sqrt(discriminant), -half + math.sqrt(discriminant)):
        crossing_s = elapsed_s(phase, travelled_m)
        if crossing_s is not None:
            yield crossing_s
