"""Which areas a moving drone is in, without looking at each of them each time.

The further away a border is, the further the drone has to travel before it can have crossed it. Until then its
area is not looked at again, so that hundreds of far servers cost nothing.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping

from upwash.core.geo import Circle, Position, ground_distance_m

_HAIR_M = 0.01
_ROUNDING_M = 1e-6  # many small steps add up to a little more or less than the way


class Ranges:
    """Follows one drone through the areas; before the first position it is in none of them."""

    def __init__(self, areas: Mapping[str, Circle]) -> None:
        self._areas = areas
        self._inside: set[str] = set()
        self._position: Position | None = None
        self._travelled_m = 0.0
        self._due = [(0.0, name) for name in areas]  # a heap: look at it again when so far has been travelled

    @property
    def is_on_border(self) -> bool:
        """Whether a border may be so near that rounding decides on which side of it the drone is."""
        return bool(self._due) and self._due[0][0] <= self._travelled_m + _HAIR_M

    def crossed(self, position: Position) -> list[str]:
        """The areas, each once, that the drone has entered or left since the last position."""
        if position == self._position:
            return []
        if self._position is not None:
            self._travelled_m += ground_distance_m(self._position, position)
        self._position = position
        due = []
        while self._due and self._due[0][0] <= self._travelled_m:
            due.append(heapq.heappop(self._due)[1])
        return [name for name in due if self._look(name, position)]

    def _look(self, name: str, position: Position) -> bool:
        """Looks at one area; whether its border was crossed since it was last looked at."""
        area = self._areas[name]
        beyond_border_m = ground_distance_m(area.centre, position) - area.radius_m
        heapq.heappush(self._due, (self._travelled_m + abs(beyond_border_m) - _ROUNDING_M, name))
        is_inside, was_inside = area.contains(position), name in self._inside
        if is_inside != was_inside:
            self._inside ^= {name}
        return is_inside != was_inside
