"""A vehicle that flies on paper: straight legs from rest to rest, on the event loop's clock."""

from __future__ import annotations

import asyncio
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from upwash.config import FaultConfig
from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.errors import AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.vehicle.kinematics import Motion, Phase, duration_s, elapsed_s, leg, steadily, stretched

_ROUNDING_M = 1e-6
_PAST_THE_BORDER_S = 1e-6
_PATIENCE_S = 60.0  # a leg has failed that takes so much longer than it should


class Manner(Protocol):
    """How a vehicle flies; `vehicle.arducopter` is one."""

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up to the altitude."""

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest."""

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """How long after its start the vehicle counts as arrived."""

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """From rest to the ground at home."""

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """From rest straight down to the ground."""


@dataclass(frozen=True, slots=True)
class Plain:
    """Speeds up and brakes alike, and takes off, returns and lands in given times whatever the distance."""

    acceleration_m_s2: float
    takeoff_s: float
    return_and_land_s: float

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up in its time."""
        return steadily(
            ground, Position(ground.east_m, ground.north_m, altitude_m), duration_s=self.takeoff_s
        )

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest, under one acceleration."""
        return leg(start, end, cruise_m_s=ground_speed_m_s, acceleration_m_s2=self.acceleration_m_s2)

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """At rest."""
        return duration_s(phases)

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """Straight home in its time."""
        return steadily(start, home, duration_s=self.return_and_land_s)

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """Straight down in the time of a return."""
        return steadily(start, Position(start.east_m, start.north_m), duration_s=self.return_and_land_s)


class ModelAutopilot:
    """Flies in its manner from the ground below `start`.

    `stretch` gives a factor on the duration of each leg, for noise, and `fault` what is wrong with the vehicle
    now; `sim.faults` says what each fault means. The battery is empty `endurance_s` after the first take-off.
    One that `hovers_at` a place has been left there by another program.
    """

    def __init__(
        self,
        start: Position,
        *,
        ground_speed_m_s: float,
        manner: Manner,
        stretch: Callable[[], float] = lambda: 1.0,
        fault: Callable[[], FaultConfig | None] = lambda: None,
        endurance_s: float | None = None,
        hovers_at: Position | None = None,
    ) -> None:
        self._ground = Position(start.east_m, start.north_m)
        self._ground_speed_m_s = ground_speed_m_s
        self._manner = manner
        self._stretch = stretch
        self._fault = fault
        self._loop = asyncio.get_running_loop()
        self._motion = Motion(0.0, (), hovers_at or self._ground)
        self._crossings: list[tuple[Sequence[Circle], list[float]]] = []  # of this motion, for each who asked
        self._moved = asyncio.Event()
        self._armed = hovers_at is not None
        self._endurance_s = endurance_s
        self._took_off_s: float | None = None

    @property
    def position(self) -> Position:
        """Where it is now."""
        return self._motion.position(self._loop.time())

    @property
    def battery_percent(self) -> float | None:
        """Falls steadily from the first take-off on."""
        if self._endurance_s is None:
            return None
        flown_s = 0.0 if self._took_off_s is None else self._loop.time() - self._took_off_s
        return 100.0 * max(0.0, 1 - flown_s / self._endurance_s)

    async def in_the_air(self) -> bool:
        """By its altitude; nobody else commands it."""
        self._reach("start")
        return self.position.altitude_m > 0

    async def arm(self) -> None:
        """At once."""
        self._reach("arm")
        self._armed = True

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs straight up."""
        self._reach("take-off")
        if not self._armed:
            raise AutopilotRefused("take-off", "the vehicle is not armed")
        if self._took_off_s is None:
            self._took_off_s = self._loop.time()
        await self._move("take-off", self._manner.takeoff(self.position, altitude_m))

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """At once, for the legs that follow."""
        self._reach("ground speed")
        self._ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Flies a leg from rest; returns when the vehicle counts as arrived."""
        self._reach("goto")
        if self.position.altitude_m <= 0:
            raise AutopilotRefused("goto", "the vehicle is on the ground")
        fault = self._fault()
        if fault is not None and fault.kind == "slow":
            await asyncio.sleep(fault.extra_s)
        way = self._manner.waypoint_leg(self.position, position, ground_speed_m_s=self._ground_speed_m_s)
        phases = stretched(way, self._stretch())
        arrival_s = self._manner.arrival_s(phases)
        if fault is not None and fault.kind == "stuck":
            await asyncio.sleep(arrival_s + _PATIENCE_S)
            raise AutopilotTimeout(
                "goto", f"the vehicle did not arrive within {arrival_s + _PATIENCE_S:.0f} s"
            )
        await self._move("goto", phases, until_s=arrival_s)

    async def hold(self) -> None:
        """Stops where it is."""
        self._reach("hold")
        await self._move("hold", ())

    async def return_home_and_land(self) -> None:
        """Back to where it took off."""
        self._reach("return")
        way = self._manner.return_and_land(self.position, self._ground)
        await self._move("return", way, end=self._ground)

    async def land(self) -> None:
        """Straight down."""
        self._reach("land")
        here = self.position
        await self._move("land", self._manner.landing(here), end=Position(here.east_m, here.north_m))

    async def disarm(self) -> None:
        """At once, on the ground."""
        self._reach("disarm")
        if self.position.altitude_m > 0:
            raise AutopilotRefused("disarm", "the vehicle is in the air")
        self._armed = False

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns just after the vehicle has crossed a border; AutopilotLost where its link is silent then."""
        while True:
            self._reach("watch the borders")
            crossing_s = self._next_crossing_s(circles)
            try:
                async with asyncio.timeout_at(crossing_s):
                    await self._moved.wait()
            except TimeoutError:
                self._reach("watch the borders")
                return

    async def close(self) -> None:
        """Nothing to give up."""

    def _reach(self, step: str) -> None:
        fault = self._fault()
        if fault is not None and fault.kind == "off":
            raise AutopilotLost(step, "the vehicle's link is silent")

    async def _move(
        self,
        step: str,
        phases: tuple[Phase, ...],
        *,
        until_s: float | None = None,
        end: Position | None = None,
    ) -> None:
        """Begins to move, and returns at the end of the phases or earlier; `end` is where that is, exactly."""
        end = end or (phases[-1].end if phases else self.position)
        self._begin(Motion(self._loop.time(), phases, end))
        self._moved.set()
        self._moved = asyncio.Event()
        await asyncio.sleep(duration_s(phases) if until_s is None else until_s)
        if until_s is None:  # a timer may be a nanosecond early, and the vehicle not quite on the ground
            self._begin(Motion(self._loop.time(), (), end))
        self._reach(step)

    def _begin(self, motion: Motion) -> None:
        self._motion = motion
        self._crossings.clear()

    def _next_crossing_s(self, circles: Sequence[Circle]) -> float | None:
        crossings_s = next((times_s for asked, times_s in self._crossings if asked is circles), None)
        if crossings_s is None:
            crossings_s = sorted(_all_crossings_s(self._motion, circles))
            self._crossings.append((circles, crossings_s))
        later = bisect_right(crossings_s, self._loop.time())
        return crossings_s[later] if later < len(crossings_s) else None


def _all_crossings_s(motion: Motion, circles: Sequence[Circle]) -> Iterator[float]:
    """Just after each time at which the motion crosses one of the circles."""
    near, begun_s = _within_reach(circles, motion.phases), motion.begun_s
    for phase in motion.phases:
        for circle in near:
            for crossing_s in _crossings_s(phase, circle):
                yield begun_s + crossing_s + _PAST_THE_BORDER_S
        begun_s += phase.duration_s


def _within_reach(circles: Sequence[Circle], phases: Sequence[Phase]) -> list[Circle]:
    """The circles whose border is no further away than the phases lead: a few of hundreds."""
    if not phases:
        return []
    start, way_m = phases[0].start, sum(phase.travelled_m(phase.duration_s) for phase in phases)
    return [
        circle
        for circle in circles
        if abs(ground_distance_m(start, circle.centre) - circle.radius_m) <= way_m + _ROUNDING_M
    ]


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
