"""Where a mission's way comes within the range of servers that can answer the calls that wait."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, ground_distance_m, nearest_share, part_way

_WELL_INSIDE = 0.9  # of a range: there a drone stops


class AnswerStops(Struct, frozen=True):
    """The ranges of servers that can answer."""

    areas: Sequence[Circle]

    def contains(self, place: Position) -> bool:
        """Whether a server can answer there."""
        return any(area.contains(place) for area in self.areas)

    def passed(self, way: Sequence[Position]) -> bool:
        """Whether the way over these places passes a range."""
        return any(
            ground_distance_m(_nearest(*leg, area.centre), area.centre) <= _WELL_INSIDE * area.radius_m
            for leg in itertools.pairwise(way)
            for area in self.areas
        )

    def beside(self, start: Position, end: Position) -> Position | None:
        """The first place well inside a range on the way between two places, or else the one least beside it.

        None without a range.
        """
        places = [_inside(start, end, area) for area in self.areas]
        return min(
            places,
            key=lambda place: (round(longer_m(start, place, end), 3), ground_distance_m(start, place)),
            default=None,
        )


def longer_m(start: Position, place: Position, end: Position) -> float:
    """How much longer the way between two places is over a third."""
    return ground_distance_m(start, place) + ground_distance_m(place, end) - ground_distance_m(start, end)


def _nearest(start: Position, end: Position, centre: Position) -> Position:
    """The place on the straight way that is nearest to the centre, at the altitude of the start."""
    return part_way(start, end, nearest_share(centre, start, end)).at_altitude(start.altitude_m)


def _inside(start: Position, end: Position, area: Circle) -> Position:
    """The first place on the way that is well inside, or the place well inside that is next to the way."""
    nearest, radius_m = _nearest(start, end, area.centre), _WELL_INSIDE * area.radius_m
    away_m, way_m = ground_distance_m(nearest, area.centre), ground_distance_m(start, nearest)
    if away_m > radius_m:
        return part_way(area.centre, nearest, radius_m / away_m).at_altitude(nearest.altitude_m)
    within_m = math.sqrt(radius_m**2 - away_m**2)
    return start if way_m <= within_m else part_way(nearest, start, within_m / way_m)
