"""How long a vehicle takes from waypoint to waypoint, its place meanwhile, and its way through ranges.

Legs are straight and flown from rest to rest: the vehicle speeds up steadily, cruises, brakes as it sped up, and
settles at its target. `Pace` has the averages of each kind of vehicle; `energy.WayHome` has the longest times.

    a leg        `Leg` with the pace's acceleration, and the settling
    a take-off   lifting + height / climb
    the return   the share of `energy.time_home_s`

Tests hold the averages against the vehicles' own motion and against recorded returns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import Struct, structs

from upwash.core.geo import Circle, Position, Reach, distance_m, inside

_ON_WAY_M = 1e-6
_LEAST_M_S2, _MOST_M_S2 = 0.05, 50.0  # what is slower or more agile was held up, or has hardly moved


class Leg(Struct, frozen=True):
    """A straight leg, from rest to rest."""

    length_m: float
    ground_speed_m_s: float
    acceleration_m_s2: float
    settling_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """The time of the whole leg (s), settling included."""
        return self._moving_s + self.settling_s if self.length_m > 0 else 0.0

    @property
    def _moving_s(self) -> float:
        return self.length_m / self._top_m_s + self._ramp_s if self.length_m > 0 else 0.0

    def reached_s(self, travelled_m: float) -> float:
        """Seconds from the start until the vehicle has travelled that far."""
        travelled_m = min(max(0.0, travelled_m), self.length_m)
        left_m = self.length_m - travelled_m
        ramp_m = self._top_m_s * self._ramp_s / 2
        if travelled_m <= ramp_m:
            return math.sqrt(2 * travelled_m / self.acceleration_m_s2)
        if left_m <= ramp_m:
            return self._moving_s - math.sqrt(2 * left_m / self.acceleration_m_s2)
        return self._ramp_s / 2 + travelled_m / self._top_m_s

    def travelled_m(self, elapsed_s: float) -> float:
        """Metres travelled `elapsed_s` after the start."""
        ramp_s = self._ramp_s
        left_s = max(0.0, self._moving_s - elapsed_s)
        if elapsed_s < ramp_s:
            return self.acceleration_m_s2 * max(0.0, elapsed_s) ** 2 / 2
        if left_s < ramp_s:
            return self.length_m - self.acceleration_m_s2 * left_s**2 / 2
        return self._top_m_s * (elapsed_s - ramp_s / 2)

    def stop(self, elapsed_s: float) -> tuple[float, float]:
        """The seconds to rest of a vehicle that brakes `elapsed_s` after the start, and the metres to there."""
        left_s = max(0.0, self._moving_s - elapsed_s)
        speed_m_s = min(self._top_m_s, self.acceleration_m_s2 * min(elapsed_s, left_s))
        braking_s = speed_m_s / self.acceleration_m_s2
        return braking_s, self.travelled_m(elapsed_s) + speed_m_s * braking_s / 2

    def back_s(self, elapsed_s: float) -> float:
        """Seconds to stop and fly back to the start, if the vehicle turns back `elapsed_s` after it has left."""
        braking_s, way_m = self.stop(elapsed_s)
        return braking_s + structs.replace(self, length_m=way_m).duration_s

    @property
    def _top_m_s(self) -> float:
        return min(self.ground_speed_m_s, math.sqrt(self.acceleration_m_s2 * self.length_m))

    @property
    def _ramp_s(self) -> float:
        return self._top_m_s / self.acceleration_m_s2


class LegPart(Struct, frozen=True):
    """A part of a leg, from one place that is passed, or its start, to the next."""

    whole: Leg
    from_m: float
    length_m: float

    @property
    def duration_s(self) -> float:
        """The time of the part (s), with the settling if the leg ends there."""
        to_m = self.from_m + self.length_m
        settling_s = self.whole.settling_s if to_m >= self.whole.length_m else 0.0
        return self.reached_s(self.length_m) + settling_s

    def reached_s(self, travelled_m: float) -> float:
        """Seconds from the start of the part until the vehicle has travelled that far."""
        return self.whole.reached_s(self.from_m + travelled_m) - self.whole.reached_s(self.from_m)


def passes(start: Position, end: Position, spot: Position) -> bool:
    """Whether the straight way passes the spot."""
    return distance_m(start, spot) + distance_m(spot, end) <= distance_m(start, end) + _ON_WAY_M


def acceleration_m_s2(length_m: float, ground_speed_m_s: float, duration_s: float) -> float | None:
    """The acceleration that explains a leg's duration; None if the duration does not determine it."""
    cruise_s = length_m / ground_speed_m_s
    if duration_s <= cruise_s:
        return None
    if duration_s < 2 * cruise_s:
        value_m_s2 = ground_speed_m_s / (duration_s - cruise_s)
    else:  # the vehicle brakes before it has reached its ground speed
        value_m_s2 = 4 * length_m / duration_s**2
    return value_m_s2 if _LEAST_M_S2 <= value_m_s2 <= _MOST_M_S2 else None


def left_m(start: Position, end: Position, area: Reach) -> float | None:
    """Metres from `start` to where a straight way that begins in the area leaves it; None if it ends inside."""
    if area.contains(end):
        return None
    back_m = entered_m(end, start, area)
    return 0.0 if back_m is None else distance_m(start, end) - back_m


def entered_m(start: Position, end: Position, area: Reach) -> float | None:
    """Metres from `start` to where a straight way that ends in the area enters it; None if it ends outside."""
    if not area.contains(end):
        return None
    if not isinstance(area, Circle) or area.contains(start):
        return 0.0
    shares = inside(area, start, end)
    return distance_m(start, end) * (1.0 if shares is None else min(1.0, max(0.0, shares[0])))


class Pace(Struct, frozen=True):
    """How the average vehicle of a kind flies; `home_share` is the return's share of the longest time home."""

    acceleration_m_s2: float = 1.0
    settling_s: float = 0.0  # of each leg: until it moves, and until it counts as arrived
    lifting_s: float = 0.0  # of each take-off, at any height
    climb_m_s: float = math.inf
    home_share: float = 1.0

    def leg(self, length_m: float, ground_speed_m_s: float) -> Leg:
        """A leg of that length at that speed."""
        return Leg(length_m, ground_speed_m_s, self.acceleration_m_s2, self.settling_s)

    def takeoff_s(self, altitude_m: float) -> float:
        """Seconds from arming to that altitude above the ground."""
        return self.lifting_s + max(0.0, altitude_m) / self.climb_m_s


ARDUCOPTER = Pace(2.15, 0.4, lifting_s=5.9, climb_m_s=2.535, home_share=0.92)
PX4 = Pace(1.18, 2.45, lifting_s=6.8, climb_m_s=1.32, home_share=0.88)  # as setpoints steer it
PACES: Mapping[str, Pace] = {"arducopter": ARDUCOPTER, "px4": PX4}
