"""How the stand-in moves: straight lines, each under a constant acceleration or none, one after the other.

A motion is continuous in position and in velocity: it takes the vehicle as it is, brakes it, and then flies
legs from rest to rest. Time is an argument everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from upwash.core.geo import Position, distance_m


@dataclass(frozen=True, slots=True)
class Velocity:
    """Where to and how fast."""

    east_m_s: float = 0.0
    north_m_s: float = 0.0
    up_m_s: float = 0.0

    @property
    def speed_m_s(self) -> float:
        """Its length."""
        return math.hypot(self.east_m_s, self.north_m_s, self.up_m_s)


@dataclass(frozen=True, slots=True)
class Phase:
    """A straight stretch that begins at `speed_m_s` and gains speed along `heading`, a vector of length 1."""

    start: Position
    heading: Velocity
    speed_m_s: float
    acceleration_m_s2: float
    duration_s: float

    def position(self, elapsed_s: float) -> Position:
        """Where the vehicle is, so long after the start of the phase."""
        travelled_m = elapsed_s * (self.speed_m_s + self.acceleration_m_s2 * elapsed_s / 2)
        return Position(
            east_m=self.start.east_m + travelled_m * self.heading.east_m_s,
            north_m=self.start.north_m + travelled_m * self.heading.north_m_s,
            altitude_m=self.start.altitude_m + travelled_m * self.heading.up_m_s,
        )

    def velocity(self, elapsed_s: float) -> Velocity:
        """How it moves, so long after the start of the phase."""
        speed_m_s = self.speed_m_s + self.acceleration_m_s2 * elapsed_s
        return Velocity(
            east_m_s=speed_m_s * self.heading.east_m_s,
            north_m_s=speed_m_s * self.heading.north_m_s,
            up_m_s=speed_m_s * self.heading.up_m_s,
        )

    @property
    def end(self) -> Position:
        """Where it leads."""
        return self.position(self.duration_s)


@dataclass(frozen=True, slots=True)
class Motion:
    """Phases flown one after the other from `begun_s` on, ending at rest."""

    begun_s: float
    phases: tuple[Phase, ...]
    end: Position

    @property
    def ends_s(self) -> float:
        """When the vehicle is at rest."""
        return self.begun_s + duration_s(self.phases)

    def position(self, now_s: float) -> Position:
        """Where the vehicle is; where it rests once the motion is over."""
        current = self._current(now_s)
        return current[0].position(current[1]) if current else self.end

    def velocity(self, now_s: float) -> Velocity:
        """How it moves; not at all once the motion is over."""
        current = self._current(now_s)
        return current[0].velocity(current[1]) if current else Velocity()

    def _current(self, now_s: float) -> tuple[Phase, float] | None:
        elapsed_s = max(0.0, now_s - self.begun_s)
        for phase in self.phases:
            if elapsed_s < phase.duration_s:
                return phase, elapsed_s
            elapsed_s -= phase.duration_s
        return None


def duration_s(phases: Sequence[Phase]) -> float:
    """How long the phases take together."""
    return sum(phase.duration_s for phase in phases)


def leg(
    start: Position, end: Position, *, cruise_m_s: float, acceleration_m_s2: float, speed_m_s: float = 0.0
) -> tuple[Phase, ...]:
    """A straight line to rest, speeding up and braking alike; a short leg never reaches cruise.

    It begins at `speed_m_s`, which must be no faster than cruise and slow enough to stop at the end.
    """
    if not (cruise_m_s > 0 and acceleration_m_s2 > 0):
        raise ValueError(
            f"a leg needs a speed and an acceleration above 0, not {cruise_m_s} m/s and {acceleration_m_s2} m/s²"
        )
    length_m = distance_m(start, end)
    if length_m == 0:
        return ()
    heading = Velocity(
        east_m_s=(end.east_m - start.east_m) / length_m,
        north_m_s=(end.north_m - start.north_m) / length_m,
        up_m_s=(end.altitude_m - start.altitude_m) / length_m,
    )
    top_m_s = min(cruise_m_s, math.sqrt(acceleration_m_s2 * length_m + speed_m_s**2 / 2))
    ramps_m = (2 * top_m_s**2 - speed_m_s**2) / (2 * acceleration_m_s2)
    cruise_s = max(0.0, (length_m - ramps_m) / top_m_s)
    faster = Phase(start, heading, speed_m_s, acceleration_m_s2, (top_m_s - speed_m_s) / acceleration_m_s2)
    steady = Phase(faster.end, heading, top_m_s, 0.0, cruise_s)
    slower = Phase(steady.end, heading, top_m_s, -acceleration_m_s2, top_m_s / acceleration_m_s2)
    return faster, steady, slower


def braking(start: Position, velocity: Velocity, *, acceleration_m_s2: float) -> tuple[Phase, ...]:
    """From the velocity to rest, straight ahead."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s == 0:
        return ()
    heading = Velocity(
        east_m_s=velocity.east_m_s / speed_m_s,
        north_m_s=velocity.north_m_s / speed_m_s,
        up_m_s=velocity.up_m_s / speed_m_s,
    )
    return (Phase(start, heading, speed_m_s, -acceleration_m_s2, speed_m_s / acceleration_m_s2),)
