"""The servers in range of a place, without a test of hundreds of far servers each time.

`AreaIndex` finds the ranges around any place; `Ranges` follows one moving drone. A drone cannot cross a border before
it has travelled the distance to it; until then the range is not tested again.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import median

from upwash.core.geo import Circle, Position, Reach, ground_distance_m, to_border_m

_MOST_SQUARES = 64  # of one area, or of one question: what reaches further is looked at each time
_LEAST_SIDE_M = 1.0
_FEW = 4  # a look at few areas is quicker than at their squares


class AreaIndex:
    """A grid of squares, each with the areas that reach into it. Areas are numbered from 0."""

    def __init__(self, areas: Sequence[Reach]) -> None:
        radii_m = [area.radius_m for area in areas if isinstance(area, Circle)]
        self._side_m = max(_LEAST_SIDE_M, 2 * median(radii_m)) if radii_m else _LEAST_SIDE_M
        self._all = list(range(len(areas)))
        self._wide: list[int] = []  # areas that reach into too many squares
        self._in_square: dict[tuple[int, int], list[int]] = defaultdict(list)
        for number, area in enumerate(areas):
            squares = self._squares(area.centre, area.radius_m) if isinstance(area, Circle) else None
            if squares is None:
                self._wide.append(number)
            else:
                for square in squares:
                    self._in_square[square].append(number)

    def near(self, place: Position, within_m: float = 0.0) -> list[int]:
        """The numbers, ascending, of all areas within `within_m` of the place, and perhaps of some farther areas."""
        squares = self._squares(place, within_m) if len(self._all) > _FEW else None
        if squares is None:
            return self._all
        found = set(self._wide)
        for square in squares:
            found.update(self._in_square.get(square, ()))
        return sorted(found)

    def _squares(self, centre: Position, radius_m: float) -> list[tuple[int, int]] | None:
        """The squares around a circle; None if there are too many."""
        east, north = self._steps(centre.east_m, radius_m), self._steps(centre.north_m, radius_m)
        if len(east) * len(north) > _MOST_SQUARES:
            return None
        return [(one, other) for one in east for other in north]

    def _steps(self, middle_m: float, radius_m: float) -> range:
        first, last = (middle_m - radius_m) // self._side_m, (middle_m + radius_m) // self._side_m
        return range(int(first), int(last) + 1)


_HAIR_M = 0.01
_ROUNDING_M = 1e-6  # many small steps add up to a little more or less than the way


class Ranges:
    """Follows one drone through the areas; before the first position the drone is in none of them."""

    def __init__(self, areas: Mapping[str, Reach]) -> None:
        self._areas = areas
        self._inside: set[str] = set()
        self._position: Position | None = None
        self._travelled_m = 0.0
        self._due = [(0.0, name) for name in areas]  # a heap: the travelled distance of the next look

    @property
    def is_on_border(self) -> bool:
        """Whether a border is within 1 cm, so that rounding decides on which side the drone is."""
        return bool(self._due) and self._due[0][0] <= self._travelled_m + _HAIR_M

    def crossed(self, position: Position) -> list[str]:
        """The areas that the drone has entered or left since the last position, each once."""
        if position == self._position:
            return []
        if self._position is not None:
            self._travelled_m += ground_distance_m(self._position, position)
        self._position = position
        due = []
        while self._due and self._due[0][0] <= self._travelled_m:
            due.append(heapq.heappop(self._due)[1])
        crossed = []
        for name in due:
            area = self._areas[name]
            border_m = to_border_m(area, position) if isinstance(area, Circle) else math.inf
            heapq.heappush(self._due, (self._travelled_m + border_m - _ROUNDING_M, name))
            if area.contains(position) != (name in self._inside):
                self._inside ^= {name}
                crossed.append(name)
        return crossed
