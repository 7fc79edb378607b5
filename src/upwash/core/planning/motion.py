"""A straight leg that is flown: where the vehicle is at a time, when it passes a place, or is in a range."""

from __future__ import annotations

import math
from typing import NamedTuple

from upwash.core.geo import Circle, Position, Reach, distance_m, part_way
from upwash.core.planning.answering import Stay
from upwash.core.planning.legs import Leg

_ON_WAY_M = 1e-6


class Motion(NamedTuple):
    """A straight leg that is flown."""

    start: Position
    end: Position
    leg: Leg
    begun_s: float

    def place(self, now_s: float) -> Position:
        """Where the vehicle is at that time."""
        length_m = self.leg.length_m
        share = min(1.0, self.leg.travelled_m(now_s - self.begun_s) / length_m) if length_m else 1.0
        return part_way(self.start, self.end, share)

    def stop(self, now_s: float) -> tuple[float, Position]:
        """When and where the vehicle rests if it brakes at that time, or at its end if that is nearer."""
        leg, flown_s = self.leg, now_s - self.begun_s
        left_s = max(0.0, leg.duration_s - leg.settling_s - flown_s)
        speed_m_s = min(leg.ground_speed_m_s, leg.acceleration_m_s2 * min(flown_s, left_s))
        way_m = leg.travelled_m(flown_s) + speed_m_s**2 / (2 * leg.acceleration_m_s2)
        if way_m >= leg.length_m - _ON_WAY_M:
            return self.begun_s + leg.duration_s, self.end
        rests_s = now_s + speed_m_s / leg.acceleration_m_s2 + leg.settling_s
        return rests_s, part_way(self.start, self.end, way_m / leg.length_m)

    def passes_s(self, spot: Position) -> float | None:
        """When it passes the spot, or arrives there; None if the spot is not on its way."""
        if spot == self.end:
            return self.begun_s + self.leg.duration_s
        if not passes(self.start, self.end, spot):
            return None
        return self.begun_s + self.leg.reached_s(distance_m(self.start, spot))


def passes(start: Position, end: Position, spot: Position) -> bool:
    """Whether the straight way passes the spot."""
    return distance_m(start, spot) + distance_m(spot, end) <= distance_m(start, end) + _ON_WAY_M


def stay_in(motion: Motion, area: Reach) -> Stay | None:
    """When the leg is in the area, up to for ever if it ends there; None if it never is."""
    if not isinstance(area, Circle):
        return -math.inf, math.inf
    way = (motion.end.east_m - motion.start.east_m, motion.end.north_m - motion.start.north_m)
    off = (motion.start.east_m - area.centre.east_m, motion.start.north_m - area.centre.north_m)
    square = way[0] ** 2 + way[1] ** 2
    if square == 0:
        return (-math.inf, math.inf) if area.contains(motion.start) else None
    along = -(off[0] * way[0] + off[1] * way[1]) / square
    beside_m2 = (off[0] + along * way[0]) ** 2 + (off[1] + along * way[1]) ** 2
    if beside_m2 > area.radius_m**2:
        return None
    half = math.sqrt((area.radius_m**2 - beside_m2) / square)
    first, last = along - half, along + half
    if last < 0 or first > 1:
        return None
    length_m = motion.leg.length_m
    return (
        -math.inf if first <= 0 else motion.begun_s + motion.leg.reached_s(first * length_m),
        math.inf if last >= 1 else motion.begun_s + motion.leg.reached_s(last * length_m),
    )
