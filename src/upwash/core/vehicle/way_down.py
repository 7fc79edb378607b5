"""How much longer a return or a landing takes, while the vehicle flies it.

    climb      to the altitude of returns, the way, the hover above home, the descent
    way        what is left of it, the hover, the descent
    hover      what is left of it, the descent
    descent    what is left of it

A part is over once the reports show that the next one has begun. At the start the whole is what `energy.time_home_s`
says without wind, which is never too short.
"""

from __future__ import annotations

from upwash.core.geo import Position, ground_distance_m
from upwash.core.planning.legs import Leg
from upwash.core.vehicle.energy import WayHome, descent_s

_AT_HOME_M = 2.0  # over the ground
_SUNK_M = 1.0  # below the altitude of the return: it has begun to descend


class WayDown:
    """Follows one vehicle on its return from `start` to `home`; without a `home` it lands below `start`."""

    def __init__(self, way: WayHome, start: Position, home: Position | None) -> None:
        self._way = way
        self._home = home
        self._top_m = start.altitude_m if home is None else max(start.altitude_m, way.altitude_m)
        length_m = 0.0 if home is None else ground_distance_m(start, home)
        self._leg = Leg(length_m, way.speed_m_s, way.acceleration_m_s2)
        self._above_home_s: float | None = None  # since when it is
        self._highest_m = start.altitude_m
        self._sinks = home is None

    def left_s(self, position: Position, *, now_s: float) -> float:
        """Seconds to the ground, by a report; times never go back."""
        way = self._way
        self._highest_m = max(self._highest_m, position.altitude_m)
        self._take(position, now_s)
        if self._sinks:
            return self._descent_s(position.altitude_m)
        if self._above_home_s is not None:
            hovers_s = max(0.0, way.hover_s - (now_s - self._above_home_s))
            return hovers_s + self._descent_s(self._highest_m)
        return self._to_home_s(position) + way.hover_s + descent_s(self._top_m, way)

    def _take(self, position: Position, now_s: float) -> None:
        if self._home is not None and ground_distance_m(position, self._home) > _AT_HOME_M:
            return
        self._sinks |= position.altitude_m < self._highest_m - _SUNK_M
        has_climbed = self._highest_m >= self._top_m - _SUNK_M
        if self._above_home_s is None and has_climbed:
            self._above_home_s = now_s

    def _to_home_s(self, position: Position) -> float:
        way, leg = self._way, self._leg
        left_m = 0.0 if self._home is None else ground_distance_m(position, self._home)
        flown_m = leg.length_m - left_m
        rise_m = max(0.0, self._top_m - position.altitude_m)
        has_left = flown_m > _AT_HOME_M  # it may climb the rest on its way
        climbs_s = 0.0 if has_left else Leg(rise_m, way.climb_m_s, way.acceleration_m_s2).duration_s
        if flown_m < 0:  # it still flies away
            return climbs_s + Leg(left_m, way.speed_m_s, way.acceleration_m_s2).duration_s
        return climbs_s + leg.duration_s - leg.reached_s(flown_m)

    def _descent_s(self, altitude_m: float) -> float:
        """Of a vehicle that sinks already, or is about to."""
        way = self._way
        slowly_m = min(max(altitude_m, 0.0), way.slowly_below_m)
        return max(altitude_m - slowly_m, 0.0) / way.descent_m_s + slowly_m / way.landing_m_s
