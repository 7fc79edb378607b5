"""When a simulated vehicle crosses borders.

A change of its motion ends no wait; it sets the timer of each wait to the next crossing.
"""

from __future__ import annotations

import asyncio
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from upwash.core.geo import Circle, ground_distance_m
from upwash.core.knowledge.ranges import AreaIndex
from upwash.sim.loop import ALIKE_S
from upwash.vehicle.body.kinematics import Motion, Phase, elapsed_s

_ROUNDING_M = 1e-6
_PAST_THE_BORDER_S = 1e-6


@dataclass(slots=True)
class _Asked:
    """Circles that a wait has used."""

    circles: Sequence[Circle]
    index: AreaIndex
    crossings_s: Sequence[float] | None = None  # of the present motion, once computed


@dataclass(slots=True, eq=False)
class _Waiting:
    """A pending wait, which ends with True at a border and with False at an interrupt."""

    asked: _Asked
    woken: asyncio.Future[bool]
    timer: asyncio.TimerHandle | None = None

    def wake(self, crossed: bool) -> None:
        if not self.woken.done():
            self.woken.set_result(crossed)


class Borders:
    """Waits for border crossings of a vehicle, through all changes of its motion."""

    def __init__(self, motion: Motion[Phase]) -> None:
        self._loop = asyncio.get_running_loop()
        self._motion = motion
        self._asked: list[_Asked] = []
        self._waiting: list[_Waiting] = []

    def moves(self, motion: Motion[Phase]) -> None:
        """Note a new motion of the vehicle."""
        self.settles(motion)
        for waiting in self._waiting:
            self._set_timer(waiting)

    def settles(self, motion: Motion[Phase]) -> None:
        """Note that the vehicle rests at the end of its motion; a border crossed just now still ends waits."""
        self._motion = motion
        for asked in self._asked:
            asked.crossings_s = None

    def interrupt(self) -> None:
        """End all present waits, which return False."""
        for waiting in self._waiting:
            waiting.wake(crossed=False)

    async def crossed(self, circles: Sequence[Circle]) -> bool:
        """Wait until just after the vehicle crosses one of the circles: True; or until an interrupt: False."""
        waiting = _Waiting(self._asked_for(circles), self._loop.create_future())
        self._set_timer(waiting)
        self._waiting.append(waiting)
        try:
            return await waiting.woken
        finally:
            self._waiting.remove(waiting)
            if waiting.timer is not None:
                waiting.timer.cancel()

    def _set_timer(self, waiting: _Waiting) -> None:
        if waiting.timer is not None:
            waiting.timer.cancel()
        next_s = self._next_crossing_s(waiting.asked)
        waiting.timer = None if next_s is None else self._loop.call_at(next_s, waiting.wake, True)

    def _next_crossing_s(self, asked: _Asked) -> float | None:
        """The time just after the motion next crosses one of the circles; None if it crosses none."""
        if asked.crossings_s is None:
            asked.crossings_s = sorted(self._all_crossings_s(asked))
        later = bisect_right(asked.crossings_s, self._loop.time() + ALIKE_S)
        return asked.crossings_s[later] if later < len(asked.crossings_s) else None

    def _all_crossings_s(self, asked: _Asked) -> Iterator[float]:
        """The time just after each crossing of the motion with a circle."""
        phases, begun_s = self._motion.phases, self._motion.begun_s
        if not phases:
            return
        way_m = sum(phase.travelled_m(phase.duration_s) for phase in phases) + _ROUNDING_M
        near = (asked.circles[number] for number in asked.index.near(phases[0].start, way_m))
        start = phases[0].start
        within_reach = [
            circle
            for circle in near
            if abs(ground_distance_m(start, circle.centre) - circle.radius_m) <= way_m
        ]
        for phase in phases:
            for circle in within_reach:
                for crossing_s in _crossings_s(phase, circle):
                    yield begun_s + crossing_s + _PAST_THE_BORDER_S
            begun_s += phase.duration_s

    def _asked_for(self, circles: Sequence[Circle]) -> _Asked:
        asked = next((asked for asked in self._asked if asked.circles is circles), None)
        if asked is None:
            asked = _Asked(circles, AreaIndex(circles))
            self._asked.append(asked)
        return asked


def _crossings_s(phase: Phase, circle: Circle) -> Iterator[float]:
    """The crossings of a phase with the circle, in seconds from its start."""
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
