"""The time of a vehicle's way home and down to the ground: before the return, and during it.

    home_s    turning round + climb to the altitude of returns + the way at the return's speed against the wind
              + hovering at its end + descent, with a wait

`WayDown` follows a return or a landing: the climb, the way, the hover above home, the descent. A part is over when
the reports show that the next part has begun. At the start the whole is what `time_home_s` says without wind:
never too little. The descent that is left takes as long as the reports show that the vehicle sinks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace

from upwash.core.geo import Position, Velocity, ground_distance_m
from upwash.core.planning.legs import Leg
from upwash.core.vehicle.return_place import NO_RALLY_POINTS, RallyPoints, ReturnPlace

STILL = Velocity()
_HOME = Position(0.0, 0.0)
_LEAST_SHARE = 1 / 3  # of the speed of returns: it flew out against the wind that it returns against
LOOK_S = 2.0  # between two looks at the battery, and until the command
LONGEST_WAIT_S = 60.0  # that a return may rest above its end: the program lands a vehicle that rests longer
HOVER_SEEN_S = 10.0  # until a rest counts as a hover
_LOOKED_EACH_S = 1.0  # at a return


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
    low_m: float = 0.0  # above the place of return: it stops there on its way down,
    waits_s: float = 0.0  # ... for this time; inf: it does not land by itself

    @property
    def rests_s(self) -> float:
        """The time above its end: the hover, and the wait lower down, until the program lands it."""
        return self.hover_s + _at_most_waited(self.waits_s)

    def to(self, place: ReturnPlace) -> WayHome:
        """The same, as far as the place has altitudes of its own."""
        altitude_m = self.altitude_m if place.altitude_m is None else place.altitude_m
        low_m = self.low_m if place.low_m is None else place.low_m
        return replace(self, altitude_m=altitude_m, low_m=low_m)


def _at_most_waited(wait_s: float) -> float:
    """The wait, or the time until the program lands a vehicle that waits longer."""
    seen_s = HOVER_SEEN_S + _LOOKED_EACH_S
    return seen_s if math.isinf(wait_s) else min(wait_s, LONGEST_WAIT_S + seen_s)


# With the parameters that each is delivered with; tests hold both against recorded returns. The hover is ArduCopter's
# RTL_LOIT_TIME of 5 s with what settling takes; a PX4 settles too before it descends.
ARDUCOPTER = WayHome(15.0, 2.5, 10.0, 1.0, 10.0, 1.5, 10.0, 0.5)
PX4 = WayHome(30.0, 2.5, 5.0, 1.0, 8.0, 1.5, 10.0, 0.5)
UNKNOWN = PX4  # the slower one, of a vehicle that has not said what it is


class EnergyFacts(Struct, frozen=True):
    """A vehicle's reports of its battery's low stages and of its way home; None for what it has not reported.

    `low_percents` has the low stage of each battery whose stage differs, by its number. The vehicle returns to its
    `home` or to one of its `rally` points. `guessed` names its parameters that are not known; a usual value replaces
    each.
    """

    low_percent: float | None = None
    low_percents: Mapping[int, float | None] = {}
    critical_percent: float | None = None
    home: Position | None = None
    way_home: WayHome | None = None
    guessed: tuple[str, ...] = ()
    rally: RallyPoints = NO_RALLY_POINTS

    def low_percent_of(self, battery: int) -> float | None:
        """The low stage of a battery in percent."""
        return self.low_percents.get(battery, self.low_percent)

    @property
    def return_altitude_m(self) -> float:
        """The least altitude above home during a return; 0 if unknown."""
        return self.way_home.altitude_m if self.way_home is not None else 0.0

    def returns_to(self, here: Position, *, otherwise: Position = _HOME) -> ReturnPlace:
        """Where a return that begins `here` ends; `otherwise` stands in for an unreported home."""
        return self.rally.chosen(here, self.home or otherwise)

    def way_to(self, place: ReturnPlace) -> WayHome:
        """How the vehicle returns to the place, slowly while it has not told how it returns."""
        return (self.way_home or UNKNOWN).to(place)

    def time_home_s(self, start: Position) -> float:
        """Seconds without wind from rest at `start` to the ground where a return from there ends."""
        place = self.returns_to(start)
        return time_home_s(start, place.position, self.way_to(place))


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
    last_m = max(top_m, way.low_m) if way.waits_s else top_m
    speed_m_s = max(way.speed_m_s - against_m_s, _LEAST_SHARE * way.speed_m_s)
    return (
        stop_s
        + Leg(top_m - start.altitude_m, way.climb_m_s, way.acceleration_m_s2).duration_s
        + Leg(length_m, speed_m_s, way.acceleration_m_s2).duration_s
        + way.rests_s
        + (last_m - top_m) / way.climb_m_s
        + descent_s(last_m - min(home.altitude_m, 0.0), way)
    )


def descent_s(altitude_m: float, way: WayHome) -> float:
    """Seconds straight down from that altitude to the ground."""
    slowly_m = min(max(altitude_m, 0.0), way.slowly_below_m)
    fast_m = max(altitude_m - slowly_m, 0.0)
    return Leg(fast_m, way.descent_m_s, way.acceleration_m_s2).duration_s + slowly_m / way.landing_m_s


_AT_HOME_M = 2.0  # over the ground
_SUNK_M = 1.0  # below the altitude of the return: it has begun to descend
_PACES = (1 / 3, 3.0)  # times the expected time of a descent: the least and the most that is believed


class _Sinking:
    """One part of a descent: the more of it is done, the more its observed pace counts."""

    def __init__(self, expected_m_s: float) -> None:
        self._expected_m_s = expected_m_s
        self._from_m, self._from_s = 0.0, 0.0  # the metres that were left when it began, and the second

    def left_s(self, left_m: float, now_s: float, *, rests: bool) -> float:
        sunk_m = self._from_m - left_m
        if rests or sunk_m <= 0:
            self._from_m, self._from_s = left_m, now_s
            return left_m / self._expected_m_s
        least, most = _PACES
        pace = min(max((now_s - self._from_s) * self._expected_m_s / sunk_m, least), most)
        done = sunk_m / self._from_m
        return left_m / self._expected_m_s * (1.0 + done * (pace - 1.0))


class WayDown:
    """Follows one vehicle on its return from `start` to `home`; with `home` None it lands below `start`."""

    def __init__(self, way: WayHome, start: Position, home: Position | None) -> None:
        self._way = way
        self._home = home or start
        self._top_m = max(start.altitude_m, way.altitude_m)
        self._leg = Leg(ground_distance_m(start, self._home), way.speed_m_s, way.acceleration_m_s2)
        self._above_home_s: float | None = None  # since when it is
        self._highest_m = start.altitude_m
        self._sinks = self._is_landing = home is None
        self._waited_from_s: float | None = None  # on its way down
        self._fast, self._slow = _Sinking(way.descent_m_s), _Sinking(way.landing_m_s)

    def left_s(self, position: Position, *, now_s: float) -> float:
        """Seconds to the ground, by a report; times never go back."""
        way = self._way
        self._highest_m = max(self._highest_m, position.altitude_m)
        if ground_distance_m(position, self._home) <= _AT_HOME_M:
            self._sinks |= position.altitude_m < self._highest_m - _SUNK_M
            if self._above_home_s is None and self._highest_m >= self._top_m - _SUNK_M:
                self._above_home_s = now_s
        if self._sinks:
            waits_s = self._waits_s(position, now_s)
            rests = waits_s > 0 and self._waited_from_s is not None
            return waits_s + self._sinking_s(position.altitude_m, now_s, rests=rests)
        if self._above_home_s is not None:
            rests_s = max(0.0, way.rests_s - (now_s - self._above_home_s))
            return rests_s + self._sinking_s(self._highest_m, now_s, rests=True)
        left_m = ground_distance_m(position, self._home)
        flown_m, rise_m = self._leg.length_m - left_m, max(0.0, self._top_m - position.altitude_m)
        has_left = flown_m > _AT_HOME_M  # it may climb the rest on its way
        climbs_s = 0.0 if has_left else Leg(rise_m, way.climb_m_s, way.acceleration_m_s2).duration_s
        whole_m = max(left_m, self._leg.length_m)  # it may still fly away
        whole_s = Leg(whole_m, way.speed_m_s, way.acceleration_m_s2).duration_s
        home_s = climbs_s + whole_s - self._leg.reached_s(flown_m)
        return home_s + way.rests_s + descent_s(self._top_m, way)

    def _waits_s(self, position: Position, now_s: float) -> float:
        """The seconds left of the wait on its way down; 0 for a landing below it."""
        way = self._way
        if self._is_landing or position.altitude_m < way.low_m - _SUNK_M:
            return 0.0
        if self._waited_from_s is None and position.altitude_m <= way.low_m + _SUNK_M:
            self._waited_from_s = now_s
        waited_s = 0.0 if self._waited_from_s is None else now_s - self._waited_from_s
        return max(0.0, _at_most_waited(way.waits_s) - waited_s)

    def _sinking_s(self, altitude_m: float, now_s: float, *, rests: bool) -> float:
        slowly_m = min(max(altitude_m, 0.0), self._way.slowly_below_m)
        fast_s = self._fast.left_s(max(altitude_m - slowly_m, 0.0), now_s, rests=rests)
        return fast_s + self._slow.left_s(slowly_m, now_s, rests=rests)
