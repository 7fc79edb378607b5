"""Its geofences: the polygons and circles that a ground station uploads, and the cylinder of its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.vehicle.body.parameters import ParameterTable

_FEWEST_CORNERS = 3


@dataclass(frozen=True, slots=True)
class Polygon:
    """An area with corners on the ground, in order."""

    corners: tuple[Position, ...]

    def contains(self, position: Position) -> bool:
        """Whether a line from there to the east crosses its border an odd number of times."""
        inside = False
        before = self.corners[-1]
        for corner in self.corners:
            if (corner.north_m > position.north_m) != (before.north_m > position.north_m):
                share = (position.north_m - corner.north_m) / (before.north_m - corner.north_m)
                if position.east_m < corner.east_m + share * (before.east_m - corner.east_m):
                    inside = not inside
            before = corner
        return inside


@dataclass(frozen=True, slots=True)
class Fence:
    """Where it may fly: in each of the inclusions, and in none of the exclusions (PX4 1.15 and later)."""

    inclusions: tuple[Polygon | Circle, ...] = ()
    exclusions: tuple[Polygon | Circle, ...] = ()

    def allows(self, position: Position) -> bool:
        """Whether it may fly there."""
        inside = all(area.contains(position) for area in self.inclusions)
        return inside and not any(area.contains(position) for area in self.exclusions)


@dataclass(frozen=True, slots=True)
class Vertex:
    """A corner, as it is uploaded: each says how many its polygon has."""

    place: Position
    corners: int
    inclusion: bool


@dataclass(frozen=True, slots=True)
class Disc:
    """A circle, as it is uploaded."""

    circle: Circle
    inclusion: bool


def assembled(items: list[Vertex | Disc]) -> Fence | None:
    """The fence that the items make up; None if a polygon has too few corners, or a circle no radius."""
    inclusions: list[Polygon | Circle] = []
    exclusions: list[Polygon | Circle] = []
    waiting = list(items)
    while waiting:
        first = waiting[0]
        area: Polygon | Circle
        if isinstance(first, Disc):
            if not 0 < first.circle.radius_m < math.inf:
                return None
            area, used = first.circle, 1
        else:
            used = first.corners
            corners = waiting[:used]
            alike = [
                each for each in corners if isinstance(each, Vertex) and each.inclusion == first.inclusion
            ]
            if used < _FEWEST_CORNERS or len(alike) != used:
                return None
            area = Polygon(tuple(each.place for each in alike))
        (inclusions if first.inclusion else exclusions).append(area)
        del waiting[:used]
    return Fence(tuple(inclusions), tuple(exclusions))


def breaches(parameters: ParameterTable, fence: Fence, place: Position) -> list[str]:
    """The events that tell which of its fences the place is outside of; home is at its origin."""
    farthest_m, highest_m = parameters["GF_MAX_HOR_DIST"], parameters["GF_MAX_VER_DIST"]
    names = []
    if 0 < farthest_m < ground_distance_m(place, Position(0.0, 0.0)):
        names.append("check_gf_violation_max_hor_dist")
    if 0 < highest_m < place.altitude_m:
        names.append("check_gf_violation_max_alt")
    if not fence.allows(place):
        names.append("check_gf_violation_custom_gf")
    return names
