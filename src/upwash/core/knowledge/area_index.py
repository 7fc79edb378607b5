"""Finds the areas around a place without looking at each of them, so that hundreds of far servers cost nothing."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from statistics import median

from upwash.core.geo import Circle, Position

_MOST_SQUARES = 64  # of one area, or of one question: what reaches further is looked at each time
_LEAST_SIDE_M = 1.0
_FEW = 4  # so many areas are sooner looked at than their squares


class AreaIndex:
    """A grid of squares, each with the areas that reach into it. Areas are known by their numbers, from 0 on."""

    def __init__(self, areas: Sequence[Circle]) -> None:
        radii_m = [area.radius_m for area in areas if math.isfinite(area.radius_m)]
        self._side_m = max(_LEAST_SIDE_M, 2 * median(radii_m)) if radii_m else _LEAST_SIDE_M
        self._all = list(range(len(areas)))
        self._wide: list[int] = []  # areas that reach into too many squares
        self._in_square: dict[tuple[int, int], list[int]] = defaultdict(list)
        for number, area in enumerate(areas):
            squares = self._squares(area.centre, area.radius_m)
            if squares is None:
                self._wide.append(number)
            else:
                for square in squares:
                    self._in_square[square].append(number)

    def near(self, place: Position, within_m: float = 0.0) -> list[int]:
        """All areas that reach to within that distance of the place over the ground, and few others, in order."""
        squares = self._squares(place, within_m) if len(self._all) > _FEW else None
        if squares is None:
            return self._all
        found = set(self._wide)
        for square in squares:
            found.update(self._in_square.get(square, ()))
        return sorted(found)

    def _squares(self, centre: Position, radius_m: float) -> list[tuple[int, int]] | None:
        """The squares around a circle; None where they are too many."""
        if not math.isfinite(radius_m) or (2 * radius_m / self._side_m + 2) ** 2 > _MOST_SQUARES:
            return None
        east, north = self._steps(centre.east_m, radius_m), self._steps(centre.north_m, radius_m)
        return [(one, other) for one in east for other in north]

    def _steps(self, middle_m: float, radius_m: float) -> range:
        first, last = (middle_m - radius_m) // self._side_m, (middle_m + radius_m) // self._side_m
        return range(int(first), int(last) + 1)
