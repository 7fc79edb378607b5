"""Where a return ends: at the vehicle's home or at one of its rally points, as its firmware chooses.

Sources: ArduPilot's AP_Rally.cpp and ModeRTL::compute_return_target, PX4's rtl.cpp (1.16.1).
"""

from __future__ import annotations

import math

from msgspec import Struct

from upwash.core.geo import Position, ground_distance_m

AT_PLACE_M = 5.0  # over the ground, of a vehicle above the place of its return


class ReturnPlace(Struct, frozen=True):
    """A place where returns end; its altitude, above home, is that of the ground there as far as known.

    A return there is at `altitude_m` above home or higher, and stops at `low_m`; None as at home.
    """

    name: str
    position: Position
    altitude_m: float | None = None
    low_m: float | None = None


class RallyPoints(Struct, frozen=True):
    """A vehicle's rally points that count, in the order of its list, and its firmware's rule of choice.

    Unless `home_counts`, home is chosen only if no point is. A point must be nearer by `nearer_by_m`, and not farther
    than `limit_m`.
    """

    points: tuple[ReturnPlace, ...] = ()
    home_counts: bool = True
    nearer_by_m: float = 0.0
    limit_m: float = math.inf

    def chosen(self, here: Position, home: Position) -> ReturnPlace:
        """Where a return that begins `here` ends."""
        at_home = ReturnPlace("home", home)
        best, best_m = at_home, ground_distance_m(here, home) if self.home_counts else math.inf
        for point in self.points:
            away_m = ground_distance_m(here, point.position)
            if away_m + self.nearer_by_m < best_m:
                best, best_m = point, away_m
        return best if best is at_home or best_m <= self.limit_m else at_home


NO_RALLY_POINTS = RallyPoints()
