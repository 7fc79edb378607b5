"""Areas on the ground that a vehicle must stay in or keep out of, at any altitude.

A border belongs to its area: it may be flown on where the vehicle must stay in, and not where it must keep out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

from msgspec import Struct

from upwash.core.geo import (
    Circle,
    Position,
    ground_distance_m,
    ground_way,
    inside,
    nearest_share,
    part_way,
    to_border_m,
)

_ON_THE_BORDER_M = 1e-3  # a tenth of the step of coordinates in plans


class Polygon(Struct, frozen=True):
    """An area between straight borders; the last corner is joined to the first."""

    corners: tuple[Position, ...]

    @property
    def borders(self) -> Iterator[tuple[Position, Position]]:
        """The sides, each as two corners; the last leads back to the first."""
        return itertools.pairwise((*self.corners, self.corners[0]))

    def contains(self, position: Position) -> bool:
        """Whether the position lies within the polygon, its border included."""
        crossed = False
        for start, end in self.borders:
            apart = _clearly_apart(position, position, start, end)
            if not apart and _distance_to_line_m(position, start, end) <= _ON_THE_BORDER_M:
                return True
            if (start.north_m > position.north_m) != (end.north_m > position.north_m):
                share = (position.north_m - start.north_m) / (end.north_m - start.north_m)
                crossed ^= position.east_m < start.east_m + share * (end.east_m - start.east_m)
        return crossed

    def met_at(self, start: Position, end: Position) -> Iterator[float]:
        """Where the leg crosses a side or passes a corner, each as a share of its length from 0 to 1."""
        for corner, following in self.borders:
            if _clearly_apart(start, end, corner, following):
                continue
            share = nearest_share(corner, start, end)
            if ground_distance_m(corner, part_way(start, end, share)) <= _ON_THE_BORDER_M:
                yield share
            crossing = _crossing_share(start, end, corner, following)
            if crossing is not None:
                yield crossing


class AreaUnion(Struct, frozen=True):
    """Joined areas: a place is within if at least one area contains it."""

    areas: tuple[Polygon | Circle, ...]

    def contains(self, position: Position) -> bool:
        """Whether the position lies within one of the areas, its border included."""
        return any(area.contains(position) for area in self.areas)


class Fence(Struct, frozen=True):
    """One area of a geofence; messages use its `name`."""

    name: str
    area: Polygon | Circle | AreaUnion
    inclusion: bool  # stay in, as opposed to keep out

    def allows(self, position: Position) -> bool:
        """Whether the fence allows the vehicle to be at the position."""
        return self.area.contains(position) == self.inclusion

    def allows_leg(self, start: Position, end: Position) -> bool:
        """Whether the fence allows the straight leg from `start` to `end`."""
        if isinstance(self.area, Circle) and self.inclusion:
            return self.area.contains(start) and self.area.contains(end)
        areas = self._areas
        if not self.inclusion:
            return not any(_meets_leg(area, start, end) for area in areas)
        # Between two crossings of borders one place stands for all.
        shares = sorted({0.0, 1.0, *(share for area in areas for share in _met_at(area, start, end))})
        halfway = ((before + after) / 2 for before, after in itertools.pairwise(shares))
        places = (part_way(start, end, share) for share in (0.0, *halfway, 1.0))
        return all(self.area.contains(place) for place in places)

    def clearance_m(self, position: Position) -> float:
        """Metres from an allowed position to the nearest forbidden one; a lower bound in joined areas."""
        distances_m = (
            _to_border_m(area, position) for area in self._areas if area.contains(position) == self.inclusion
        )
        return max(distances_m, default=0.0) if self.inclusion else min(distances_m, default=math.inf)

    @property
    def _areas(self) -> tuple[Polygon | Circle, ...]:
        return self.area.areas if isinstance(self.area, AreaUnion) else (self.area,)


def breached_by_position(fences: Sequence[Fence], position: Position) -> Fence | None:
    """The first fence that does not allow the position; None if all do."""
    return next((fence for fence in fences if not fence.allows(position)), None)


def breached_by_leg(fences: Sequence[Fence], start: Position, end: Position) -> Fence | None:
    """The first fence that does not allow the straight leg; None if all do."""
    return next((fence for fence in fences if not fence.allows_leg(start, end)), None)


def breached_by_move(fences: Sequence[Fence], start: Position, target: Position) -> Fence | None:
    """The first fence that does not allow the target, or the straight leg there; None if all do.

    If `start` is not allowed itself, the leg is: the vehicle must be able to come back in.
    """
    fence = breached_by_position(fences, target)
    if fence is None and breached_by_position(fences, start) is None:
        return breached_by_leg(fences, start, target)
    return fence


def breached_by_way(fences: Sequence[Fence], places: Sequence[Position]) -> Fence | None:
    """The first fence that does not allow one of the straight legs from place to place; None if all do."""
    legs = itertools.pairwise(places) if fences else ()
    return next((fence for leg in legs if (fence := breached_by_leg(fences, *leg)) is not None), None)


def _met_at(area: Polygon | Circle, start: Position, end: Position) -> Iterator[float]:
    if isinstance(area, Polygon):
        return area.met_at(start, end)
    return (share for share in inside(area, start, end) or () if 0 <= share <= 1)


def _meets_leg(area: Polygon | Circle, start: Position, end: Position) -> bool:
    if isinstance(area, Circle):
        return _distance_to_line_m(area.centre, start, end) <= area.radius_m
    return area.contains(start) or any(True for _ in area.met_at(start, end)) or area.contains(end)


def _to_border_m(area: Polygon | Circle, position: Position) -> float:
    if isinstance(area, Polygon):
        return min(_distance_to_line_m(position, *side) for side in area.borders)
    return to_border_m(area, position)


def _clearly_apart(start: Position, end: Position, corner: Position, following: Position) -> bool:
    """Whether a leg and a side lie in separate rectangles, a quick test for large plans."""
    return (
        max(start.east_m, end.east_m) + _ON_THE_BORDER_M < min(corner.east_m, following.east_m)
        or max(corner.east_m, following.east_m) + _ON_THE_BORDER_M < min(start.east_m, end.east_m)
        or max(start.north_m, end.north_m) + _ON_THE_BORDER_M < min(corner.north_m, following.north_m)
        or max(corner.north_m, following.north_m) + _ON_THE_BORDER_M < min(start.north_m, end.north_m)
    )


def _distance_to_line_m(position: Position, start: Position, end: Position) -> float:
    return ground_distance_m(position, part_way(start, end, nearest_share(position, start, end)))


def _crossing_share(start: Position, end: Position, corner: Position, following: Position) -> float | None:
    """Where the leg crosses the side, as a share of its length from 0 to 1; None if it does not, or is parallel."""
    way, side, to_corner = ground_way(start, end), ground_way(corner, following), ground_way(start, corner)
    if (slant := _cross(way, side)) == 0:
        return None
    share, side_share = _cross(to_corner, side) / slant, _cross(to_corner, way) / slant
    return share if 0 <= share <= 1 and 0 <= side_share <= 1 and math.isfinite(share) else None


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real
