"""How a vehicle gains and loses speed in steps of its own, towards any speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from upwash.core.geo import Position, Velocity, distance_m
from upwash.vehicle.body.kinematics import NO_LENGTH_M, Phase, heading_of, last_true


@dataclass(frozen=True)
class Ramp:
    """How a vehicle gains its speed from rest, or loses it: pairs of a duration and the acceleration at its end.

    The acceleration runs in straight lines between them, from 0 on. The pairs add up to `full_m_s`. Greater speeds
    are gained under the same accelerations over a longer time, smaller ones under smaller ones with the same jerk.
    """

    knots: tuple[tuple[float, float], ...]

    @cached_property
    def full_m_s(self) -> float:
        """The change of speed that the pairs add up to."""
        return abs(sum(part.gained_m_s for part in self._parts(1.0, 1.0)))

    @cached_property
    def full_s(self) -> float:
        """The seconds that the pairs add up to."""
        return sum(duration_s for duration_s, _ in self.knots)

    def length_m(self, speed_m_s: float) -> float:
        """The distance in m from rest to the speed, or from the speed to rest."""
        return self._share * speed_m_s * self._slowness(speed_m_s) * self.full_s

    def phases(self, start: Position, heading: Velocity, speed_m_s: float) -> tuple[Phase, ...]:
        """The motion from rest to the speed or, with negative accelerations, from the speed to rest."""
        slowness = self._slowness(speed_m_s)
        strength = speed_m_s / self.full_m_s / slowness
        now_m_s = speed_m_s if self.knots[0][1] < 0 else 0.0  # it brakes
        phases: list[Phase] = []
        for part in self._parts(slowness, strength):
            phases.append(
                Phase(start, heading, now_m_s, part.acceleration_m_s2, part.duration_s, part.jerk_m_s3)
            )
            start, now_m_s = phases[-1].end, now_m_s + part.gained_m_s
        return tuple(phases)

    @cached_property
    def _share(self) -> float:
        """The mean speed on the way, as a share of the speed gained or lost."""
        way = self.phases(Position(0.0, 0.0), Velocity(east_m_s=1.0), self.full_m_s)
        return way[-1].end.east_m / self.full_m_s / self.full_s

    def _slowness(self, speed_m_s: float) -> float:
        share = speed_m_s / self.full_m_s
        return max(share, math.sqrt(share))

    def _parts(self, slowness: float, strength: float) -> list[_Part]:
        before, parts = 0.0, []
        for duration_s, after in self.knots:
            parts.append(_Part(duration_s * slowness, before * strength, after * strength))
            before = after
        return parts


@dataclass(frozen=True, slots=True)
class _Part:
    duration_s: float
    acceleration_m_s2: float
    ends_at_m_s2: float

    @property
    def jerk_m_s3(self) -> float:
        return (self.ends_at_m_s2 - self.acceleration_m_s2) / self.duration_s

    @property
    def gained_m_s(self) -> float:
        return self.duration_s * (self.acceleration_m_s2 + self.ends_at_m_s2) / 2


def ramped_leg(
    start: Position, end: Position, *, cruise_m_s: float, faster: Ramp, slower: Ramp
) -> tuple[Phase, ...]:
    """A straight line from rest to rest along two ramps; a short leg never reaches cruise."""
    length_m = distance_m(start, end)
    if length_m < NO_LENGTH_M:
        return ()
    heading = heading_of(start, end)
    top_m_s = _highest_m_s(length_m, cruise_m_s, faster, slower)
    speeding_up = faster.phases(start, heading, top_m_s)
    cruise_m = max(0.0, length_m - faster.length_m(top_m_s) - slower.length_m(top_m_s))
    steady = Phase(speeding_up[-1].end, heading, top_m_s, 0.0, cruise_m / top_m_s)
    return *speeding_up, steady, *slower.phases(steady.end, heading, top_m_s)


def _highest_m_s(length_m: float, cruise_m_s: float, faster: Ramp, slower: Ramp) -> float:
    """The speed, cruise at most, whose two ramps fit into the length."""

    def fits(speed_m_s: float) -> bool:
        return faster.length_m(speed_m_s) + slower.length_m(speed_m_s) <= length_m

    return cruise_m_s if fits(cruise_m_s) else last_true(fits, cruise_m_s)
