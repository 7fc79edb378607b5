"""The time of a vehicle's way home and down to the ground: before the return, and during it.

    home_s    turning round + climb to the altitude of returns + the way at the return's speed against the wind
              + hovering above home + descent

`WayDown` follows a return or a landing: the climb, the way, the hover above home, the descent. A part is over when
the reports show that the next part has begun. At the start the whole is what `time_home_s` says without wind:
never too little.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from upwash.core.geo import Position, Velocity, ground_distance_m
from upwash.core.planning.legs import Leg

STILL = Velocity()
_LEAST_SHARE = 1 / 3  # of the speed of returns: it flew out against the wind that it returns against
LOOK_S = 2.0  # between two looks at the battery, and until the command


class WayHome(Struct, frozen=True):
    """How a vehicle returns and lands, by its parameters."""

    altitude_m: float  # it climbs so high before it returns
    climb_m_s: float
    speed_m_s: float  # over the ground, without wind
    acceleration_m_s2: float
    hover_s: float  # above home, with all other fixed times
    descent_m_s: float
    slowly_below_m: float  # the last metres,
    landing_m_s: float  # ... which it descends at this speed


# With the parameters that each is delivered with; tests hold both against recorded returns. The hover is ArduCopter's
# RTL_LOIT_TIME of 5 s with what settling takes; a PX4 settles too before it descends.
ARDUCOPTER = WayHome(15.0, 2.5, 10.0, 1.0, 10.0, 1.5, 10.0, 0.5)
PX4 = WayHome(30.0, 2.5, 5.0, 1.0, 8.0, 1.5, 10.0, 0.5)
UNKNOWN = PX4  # the slower one, of a vehicle that has not said what it is


class EnergyFacts(Struct, frozen=True):
    """A vehicle's reports of its battery's low stages and of its way home; None for what it has not reported.

    `home` is where it returns. `guessed` names its parameters that are not known; a usual value replaces each.
    """

    low_percent: float | None = None
    critical_percent: float | None = None
    home: Position | None = None
    way_home: WayHome | None = None
    guessed: tuple[str, ...] = ()

    @property
    def return_altitude_m(self) -> float:
        """The least altitude above home during a return; 0 if unknown."""
        return self.way_home.altitude_m if self.way_home is not None else 0.0


def in_words(guessed: Sequence[str]) -> str:
    """A phrase that names the vehicle's parameters that are not known."""
    return f"guessed: {', '.join(guessed)} {'is' if len(guessed) == 1 else 'are'} not known"


def time_home_s(
    start: Position, home: Position, way: WayHome, *, against_m_s: float = 0.0, velocity: Velocity = STILL
) -> float:
    """Seconds from `start` to the ground at `home`; wind takes `against_m_s` from the ground speed.

    A moving vehicle must stop first; the distance until then counts as away from home.
    """
    stop_s = velocity.speed_m_s / way.acceleration_m_s2
    length_m = ground_distance_m(start, home) + velocity.speed_m_s * (LOOK_S + stop_s / 2)
    top_m = max(start.altitude_m, way.altitude_m)
    speed_m_s = max(way.speed_m_s - against_m_s, _LEAST_SHARE * way.speed_m_s)
    return (
        stop_s
        + Leg(top_m - start.altitude_m, way.climb_m_s, way.acceleration_m_s2).duration_s
        + Leg(length_m, speed_m_s, way.acceleration_m_s2).duration_s
        + way.hover_s
        + descent_s(top_m, way)
    )


def descent_s(altitude_m: float, way: WayHome) -> float:
    """Seconds straight down from that altitude to the ground."""
    slowly_m = min(max(altitude_m, 0.0), way.slowly_below_m)
    fast_m = max(altitude_m - slowly_m, 0.0)
    return Leg(fast_m, way.descent_m_s, way.acceleration_m_s2).duration_s + slowly_m / way.landing_m_s


_AT_HOME_M = 2.0  # over the ground
_SUNK_M = 1.0  # below the altitude of the return: it has begun to descend


class WayDown:
    """Follows one vehicle on its return from `start` to `home`; with `home` None it lands below `start`."""

    def __init__(self, way: WayHome, start: Position, home: Position | None) -> None:
        self._way = way
        self._home = home or start
        self._top_m = max(start.altitude_m, way.altitude_m)
        self._leg = Leg(ground_distance_m(start, self._home), way.speed_m_s, way.acceleration_m_s2)
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
        if ground_distance_m(position, self._home) > _AT_HOME_M:
            return
        self._sinks |= position.altitude_m < self._highest_m - _SUNK_M
        has_climbed = self._highest_m >= self._top_m - _SUNK_M
        if self._above_home_s is None and has_climbed:
            self._above_home_s = now_s

    def _to_home_s(self, position: Position) -> float:
        way, leg = self._way, self._leg
        left_m = ground_distance_m(position, self._home)
        flown_m = leg.length_m - left_m
        rise_m = max(0.0, self._top_m - position.altitude_m)
        has_left = flown_m > _AT_HOME_M  # it may climb the rest on its way
        climbs_s = 0.0 if has_left else Leg(rise_m, way.climb_m_s, way.acceleration_m_s2).duration_s
        whole_m = max(left_m, leg.length_m)  # it may still fly away
        whole = Leg(whole_m, way.speed_m_s, way.acceleration_m_s2)
        return climbs_s + whole.duration_s - leg.reached_s(flown_m)

    def _descent_s(self, altitude_m: float) -> float:
        way = self._way
        slowly_m = min(max(altitude_m, 0.0), way.slowly_below_m)
        return max(altitude_m - slowly_m, 0.0) / way.descent_m_s + slowly_m / way.landing_m_s
