"""A vehicle that flies on paper: straight legs from rest to rest, on the event loop's clock."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator, Sequence

from upwash.core.geo import Circle, Position, distance_m
from upwash.errors import AutopilotRefused
from upwash.vehicle.kinematics import Motion, Phase, Velocity, leg

_PAST_THE_BORDER_S = 1e-6


class ModelAutopilot:
    """Takes off, flies and lands in the times that it is given; nothing ever goes wrong with it.

    `stretch` gives a factor on the duration of each leg, for noise. The vehicle starts on the ground below
    `start`, and returns there within `return_and_land_s` from wherever it is.
    """

    def __init__(
        self,
        start: Position,
        *,
        ground_speed_m_s: float,
        acceleration_m_s2: float,
        takeoff_s: float,
        return_and_land_s: float,
        stretch: Callable[[], float] = lambda: 1.0,
    ) -> None:
        self._ground = Position(start.east_m, start.north_m)
        self._ground_speed_m_s = ground_speed_m_s
        self._acceleration_m_s2 = acceleration_m_s2
        self._takeoff_s = takeoff_s
        self._return_and_land_s = return_and_land_s
        self._stretch = stretch
        self._loop = asyncio.get_running_loop()
        self._motion = Motion(0.0, (), self._ground)
        self._moved = asyncio.Event()
        self._armed = False

    @property
    def position(self) -> Position:
        """Where it is now."""
        return self._motion.position(self._loop.time())

    async def arm(self) -> None:
        """At once."""
        self._armed = True

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs straight up, in its time whatever the altitude."""
        if not self._armed:
            raise AutopilotRefused("take-off", "the vehicle is not armed")
        here = self.position
        await self._move(_steadily(here, Position(here.east_m, here.north_m, altitude_m), self._takeoff_s))

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """At once, for the legs that follow."""
        self._ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Flies a leg from rest to rest."""
        if self.position.altitude_m <= 0:
            raise AutopilotRefused("goto", "the vehicle is on the ground")
        stretch = self._stretch()
        await self._move(
            leg(
                self.position,
                position,
                cruise_m_s=self._ground_speed_m_s / stretch,
                acceleration_m_s2=self._acceleration_m_s2 / stretch**2,
            )
        )

    async def hold(self) -> None:
        """Stops where it is."""
        await self._move(())

    async def return_home_and_land(self) -> None:
        """Back to where it took off, in its time whatever the distance."""
        await self._move(_steadily(self.position, self._ground, self._return_and_land_s))

    async def land(self) -> None:
        """Straight down, in the time of a return."""
        here = self.position
        await self._move(_steadily(here, Position(here.east_m, here.north_m), self._return_and_land_s))

    async def disarm(self) -> None:
        """At once, on the ground."""
        if self.position.altitude_m > 0:
            raise AutopilotRefused("disarm", "the vehicle is in the air")
        self._armed = False

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns just after the vehicle has entered or left a circle."""
        while True:
            crossing_s = self._next_crossing_s(circles)
            try:
                async with asyncio.timeout_at(crossing_s):
                    await self._moved.wait()
            except TimeoutError:
                return

    async def close(self) -> None:
        """Nothing to give up."""

    async def _move(self, phases: tuple[Phase, ...]) -> None:
        end = phases[-1].end if phases else self.position
        self._motion = Motion(self._loop.time(), phases, end)
        self._moved.set()
        self._moved = asyncio.Event()
        await asyncio.sleep(self._motion.ends_s - self._loop.time())

    def _next_crossing_s(self, circles: Sequence[Circle]) -> float | None:
        now_s, begun_s = self._loop.time(), self._motion.begun_s
        for phase in self._motion.phases:
            crossings_s = [
                begun_s + elapsed_s + _PAST_THE_BORDER_S
                for circle in circles
                for elapsed_s in _crossings_s(phase, circle)
            ]
            later_s = [crossing_s for crossing_s in crossings_s if crossing_s > now_s]
            if later_s:
                return min(later_s)
            begun_s += phase.duration_s
        return None


def _steadily(start: Position, end: Position, duration_s: float) -> tuple[Phase, ...]:
    length_m = distance_m(start, end)
    if length_m == 0 or duration_s == 0:
        return (Phase(end, Velocity(), 0.0, 0.0, duration_s),)
    heading = Velocity(
        (end.east_m - start.east_m) / length_m,
        (end.north_m - start.north_m) / length_m,
        (end.altitude_m - start.altitude_m) / length_m,
    )
    return (Phase(start, heading, length_m / duration_s, 0.0, duration_s),)


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
        elapsed_s = _elapsed_s(phase, travelled_m)
        if elapsed_s is not None and 0 <= elapsed_s <= phase.duration_s:
            yield elapsed_s


def _elapsed_s(phase: Phase, travelled_m: float) -> float | None:
    """When a phase has covered that distance, if it ever does."""
    speed_m_s, acceleration_m_s2 = phase.speed_m_s, phase.acceleration_m_s2
    under_root = speed_m_s**2 + 2 * acceleration_m_s2 * travelled_m
    if travelled_m < 0 or under_root < 0:
        return None
    divisor = speed_m_s + math.sqrt(under_root)
    return 2 * travelled_m / divisor if divisor > 0 else None
