"""A flight that was recorded: places over time, and when it passes a place."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from upwash.core.geo import Position, ground_distance_m, nearest_share, part_way

THERE_M = 1.0  # a place is reached within that
NEAR_M = 20.0  # a place is passed within that, where the track is nearest to it
_NEARER_M = 0.1  # less is the noise of a hover
_RISEN_M = 0.5  # below the altitude of the take-off


@dataclass(frozen=True)
class Track:
    """Places at ascending times (s) from 0 on; straight and steady between them."""

    times_s: Sequence[float]
    places: Sequence[Position]

    @property
    def ends_s(self) -> float:
        """The time of the last place."""
        return self.times_s[-1]

    def risen_s(self, altitude_m: float) -> float | None:
        """When it is first as high; None if it stays lower."""
        for time_s, place in zip(self.times_s, self.places, strict=True):
            if place.altitude_m >= altitude_m - _RISEN_M:
                return time_s
        return None

    def passing_s(self, spot: Position, *, after_s: float) -> float | None:
        """When it first reaches the spot over the ground, or is nearest while it passes; None if it does not."""
        at_s, nearest_m = math.nan, math.inf
        first = max(0, bisect_right(self.times_s, after_s) - 1)
        for number in range(first, len(self.times_s) - 1):
            begins_s, ends_s = self.times_s[number : number + 2]
            start, end = self.places[number : number + 2]
            now_s, off_m = _nearest(
                spot, start, end, begins_s=begins_s, ends_s=ends_s, from_s=max(begins_s, after_s)
            )
            if nearest_m <= THERE_M and off_m > nearest_m - _NEARER_M:
                break  # it passes, or stays
            if nearest_m <= NEAR_M < off_m:
                break
            if off_m <= NEAR_M and off_m < nearest_m:
                at_s, nearest_m = now_s, off_m
        return at_s if nearest_m <= NEAR_M else None

    def nearest_m(self, spot: Position) -> float:
        """The least distance from the spot over the ground."""
        ways = zip(pairwise(self.places), pairwise(self.times_s), strict=True)
        return min(
            _nearest(spot, *way, begins_s=begins_s, ends_s=ends_s, from_s=begins_s)[1]
            for way, (begins_s, ends_s) in ways
        )


def _nearest(
    spot: Position, start: Position, end: Position, *, begins_s: float, ends_s: float, from_s: float
) -> tuple[float, float]:
    """When a straight stretch is nearest to the spot, not before `from_s`, and how near."""
    lasts_s = ends_s - begins_s
    share = max((from_s - begins_s) / lasts_s, nearest_share(spot, start, end))
    return begins_s + share * lasts_s, ground_distance_m(part_way(start, end, share), spot)
