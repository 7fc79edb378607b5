"""Whether a return lands: a vehicle may hover at its end for ever, or come no nearer.

A return rests above its end before it descends, and some rest once more on their way down (`WayHome`). A longer rest
there is a hover: its parameters say so, or were changed, or were never told. Only reports count.
"""

from __future__ import annotations

import math

from upwash.core.geo import Position, distance_m, ground_distance_m
from upwash.core.vehicle.return_place import AT_PLACE_M, ReturnPlace
from upwash.core.vehicle.way_home import HOVER_SEEN_S, LONGEST_WAIT_S, WayHome

_RESTS_M = 1.5  # hovering vehicles wander less
_SUNK_M = 1.0
_HURRIED_S = 3.0
_NEARER_M = 3.0
_NO_NEARER_S = 30.0


class ReturnWatch:
    """Follows one return to its `place` by the vehicle's reports; times never go back.

    Unless its parameters are `known`, the vehicle may rest above the place for the longest time.
    """

    def __init__(
        self, way: WayHome, place: ReturnPlace, start: Position, *, now_s: float, known: bool
    ) -> None:
        self.place = place
        self._way = way
        self._rest_s = min(way.hover_s, LONGEST_WAIT_S) if known else LONGEST_WAIT_S
        self._here = self._rests_at = start
        self._now_s = self._rests_since_s = self._above_s = now_s
        self._highest_m = -math.inf  # at the place
        self._nearest_m, self._level_m = math.inf, start.altitude_m
        self._nearer_s = now_s
        self.hurries = False  # the battery leaves no time for a rest

    def take(self, position: Position, now_s: float) -> None:
        """Takes in a report."""
        self._here, self._now_s = position, now_s
        if distance_m(position, self._rests_at) > _RESTS_M:
            self._rests_at, self._rests_since_s = position, now_s
        if self._is_at_place:
            self._highest_m = max(self._highest_m, position.altitude_m)
        if not self._has_sunk:
            self._above_s = now_s
        nearer = self._is_at_place or self.away_m <= self._nearest_m - _NEARER_M
        if nearer or abs(position.altitude_m - self._level_m) >= _NEARER_M:
            self._nearest_m = min(self._nearest_m, self.away_m)
            self._level_m, self._nearer_s = position.altitude_m, now_s

    @property
    def away_m(self) -> float:
        """How far from the place it is, over the ground."""
        return ground_distance_m(self._here, self.place.position)

    @property
    def hovers(self) -> bool:
        """Whether it rests at the end of its return for longer than on its way down."""
        patience_s = _HURRIED_S if self.hurries else self._allowed_s() + HOVER_SEEN_S
        since_s = max(self._rests_since_s, self._above_s) if self._has_sunk else self._rests_since_s
        return self._is_at_place and self._now_s - since_s >= patience_s

    @property
    def no_nearer_s(self) -> float:
        """The time since it last came nearer, climbed or descended; 0 while that is short."""
        since_s = self._now_s - self._nearer_s
        return since_s if since_s >= _NO_NEARER_S and not self._is_at_place else 0.0

    @property
    def _is_at_place(self) -> bool:
        return self.away_m <= AT_PLACE_M

    def _allowed_s(self) -> float:
        way, altitude_m = self._way, self._here.altitude_m
        if way.waits_s and abs(altitude_m - way.low_m) <= _RESTS_M:
            return 0.0 if math.isinf(way.waits_s) else min(way.waits_s, LONGEST_WAIT_S)
        return 0.0 if self._has_sunk else self._rest_s

    @property
    def _has_sunk(self) -> bool:
        """Whether its rest above the end is over."""
        return self._here.altitude_m < self._highest_m - _SUNK_M
