"""When a vehicle must turn back: the battery that the way home needs, compared with what is left.

The laws, in percent of the battery and in seconds of flight; way_home.py has home_s:

    needed    rate * home_s
    floor     the highest of: the vehicle's own low-battery stage, rate * reserve_s, reserve_percent
    margin    left - needed - floor; below 0 it is time to turn back

More wind, a longer way, a higher rate or less battery never makes the margin larger. Nothing counts on a tailwind, on
an air speed above that of returns, or on a battery that lasts longer than in this flight.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from upwash.core.geo import Position, Velocity, ahead, ground_way
from upwash.core.vehicle.way_home import (
    LOOK_S,
    STILL,
    UNKNOWN,
    EnergyFacts,
    descent_s,
    in_words,
    time_home_s,
)

_STEP_PERCENT = 1.0  # of the reports: 80 means 80 up to 81
_WINDOW_S = 180.0  # over which the consumption of now is measured
_LEAST_S = 60.0  # less flight than this says nothing of it
_SWAPPED_PERCENT = 3.0  # a rise of more is another battery, or a sag that is over
_STEADY_S, _STEADY_M_S = 3.0, 0.3  # at a speed within this for this long it does not speed up or brake
_LEVEL_M_S = 0.3  # a leg that climbs or descends faster is slow for that reason
_LEAST_M_S = 0.5  # below this it stands
_WIND_KEPT_S = 600.0  # how long a slow leg counts for the wind


class FlightReport(Struct, frozen=True):
    """A vehicle's reports at one moment of a flight.

    `charges_percent` has the known charges of its batteries by number, `leg_speed_m_s` is the commanded speed of its
    leg.
    """

    time_s: float
    position: Position
    charges_percent: Mapping[int, float] = {}
    velocity: Velocity | None = None
    leg_speed_m_s: float | None = None
    wind: Velocity | None = None  # of the air over the ground


class Reserve(Struct, frozen=True):
    """What must be left at touchdown, as a person asked: seconds of flight, and percent of the battery."""

    seconds: float
    percent: float | None = None


class Margin(Struct, frozen=True):
    """What is left against what is needed, in percent; `rate_percent_s` is None while nothing tells it.

    Without a rate the way home and the reserve's seconds count nothing. `battery` is the number of the battery, if
    there are several.
    """

    left_percent: float
    rate_percent_s: float | None
    home_s: float
    reserve: Reserve
    low_percent: float | None = None
    guessed: tuple[str, ...] = ()
    battery: int | None = None

    @property
    def needed_percent(self) -> float:
        """What the way home takes."""
        return (self.rate_percent_s or 0.0) * self.home_s

    @property
    def _reserve_s_percent(self) -> float:
        return (self.rate_percent_s or 0.0) * self.reserve.seconds

    @property
    def floor_percent(self) -> float:
        """The percent of the battery that must be left at touchdown."""
        return max(self._reserve_s_percent, self.low_percent or 0.0, self.reserve.percent or 0.0)

    @property
    def percent(self) -> float:
        """The margin in percent of the battery; below 0 too little is left."""
        return self.left_percent - self.needed_percent - self.floor_percent

    @property
    def turn_back(self) -> bool:
        """Whether the vehicle must turn back now."""
        return self.percent < 0

    def __str__(self) -> str:
        home = f"{self.home_s:.0f} s to home need {self.needed_percent:.0f} %"
        if self.rate_percent_s is None:
            home = f"{self.home_s:.0f} s to home need what is not known yet"
        if self.floor_percent == self._reserve_s_percent:
            floor = f"{self.reserve.seconds:g} s of reserve {self._reserve_s_percent:.0f} %"
        elif self.floor_percent == self.reserve.percent:
            floor = f"the reserve is {self.reserve.percent:g} %"
        else:
            floor = f"the vehicle's own low-battery stage is at {self.low_percent:g} %"
        said = f"{home}, {floor}, {self.left_percent:.0f} % is left{in_battery(self.battery)}"
        return f"{said} ({in_words(self.guessed)})" if self.guessed else said


class Consumption:
    """The battery's rate of loss, from reports in steps of a percent, with gaps and jumps.

    A full battery lasts at most `endurance_s`, if given.
    """

    def __init__(self, endurance_s: float | None = None) -> None:
        self._least_percent_s = 100.0 / endurance_s if endurance_s else 0.0
        self._first: tuple[float, float] | None = None
        self._recent: deque[tuple[float, float]] = deque()
        self._lowest_percent = math.inf
        self._before_swap_percent_s = 0.0

    def take(self, time_s: float, percent: float | None) -> None:
        """Takes in a report of a vehicle in flight; times never go back."""
        if percent is None:
            return
        if percent > self._lowest_percent + _SWAPPED_PERCENT:
            self._before_swap_percent_s = self.rate_percent_s or 0.0
            self._first = None
            self._recent.clear()
            self._lowest_percent = math.inf
        self._first = self._first or (time_s, percent)
        self._lowest_percent = min(self._lowest_percent, percent)
        self._recent.append((time_s, percent))
        while len(self._recent) > 1 and self._recent[1][0] <= time_s - _WINDOW_S:
            self._recent.popleft()

    def left_percent(self, now_s: float) -> float:
        """The charge now: the last report, and on from there at the rate of loss."""
        reported_s, percent = self._recent[-1]
        return percent - (self.rate_percent_s or 0.0) * (now_s - reported_s)

    @property
    def rate_percent_s(self) -> float | None:
        """Percent per second: the higher of the whole flight's rate and the last 3 minutes' rate; None if unknown."""
        rates = [self._least_percent_s]
        if self._first is not None:
            now_s, percent = self._recent[-1]
            for begun_s, before_percent in (self._first, self._recent[0]):
                if (flown_s := now_s - begun_s) >= _LEAST_S:  # it may have lost one step of the report more
                    rates.append(max(before_percent - percent + _STEP_PERCENT, 0.0) / flown_s)
            if now_s - self._first[0] < _WINDOW_S:
                rates.append(self._before_swap_percent_s)
        return max(rates) or None


class Wind:
    """The ground speed lost to wind, by the vehicle's reports of wind and by legs that were slow."""

    def __init__(self) -> None:
        self._reported: Velocity | None = None
        # When a leg was flown steadily and slower than commanded, its direction (of length 1), and how much slower.
        self._slow: deque[tuple[float, complex, float]] = deque()
        self._steady: deque[tuple[float, complex, float]] = deque()  # when, at what velocity, as commanded

    def take(self, report: FlightReport) -> None:
        """Takes in a report of a vehicle in flight; times never go back."""
        self._reported = report.wind or self._reported
        while self._slow and self._slow[0][0] < report.time_s - _WIND_KEPT_S:
            self._slow.popleft()
        velocity, told_m_s = report.velocity, report.leg_speed_m_s
        if velocity is None or told_m_s is None or abs(velocity.up_m_s) > _LEVEL_M_S:
            self._steady.clear()
            return
        flown_m_s = complex(velocity.east_m_s, velocity.north_m_s)
        self._steady.append((report.time_s, flown_m_s, told_m_s))
        while any(
            told_m_s != before_m_s or abs(flown_m_s - past_m_s) > _STEADY_M_S
            for _, past_m_s, before_m_s in self._steady
        ):
            self._steady.popleft()
        is_steady = report.time_s - self._steady[0][0] >= _STEADY_S
        if is_steady and _LEAST_M_S <= abs(flown_m_s) < told_m_s:
            self._slow.append((report.time_s, flown_m_s / abs(flown_m_s), told_m_s - abs(flown_m_s)))

    def against_m_s(self, start: Position, end: Position, speed_m_s: float) -> float:
        """Metres per second of ground speed lost at that air speed, on the way from start to end.

        If both places are the same it is the loss in the worst direction, as a moving vehicle may come back from any
        side.
        """
        way = ground_way(start, end)
        if not way:
            reported_m_s = self._reported.ground_m_s if self._reported else 0.0
            return max(reported_m_s, *(short_m_s for _, _, short_m_s in self._slow), 0.0)
        way /= abs(way)
        slow_m_s = [short_m_s * (slow * way.conjugate()).real for _, slow, short_m_s in self._slow]
        if self._reported is not None:
            blows = complex(self._reported.east_m_s, self._reported.north_m_s) * way.conjugate()
            ahead_m_s = math.sqrt(max(0.0, speed_m_s**2 - blows.imag**2))  # with the nose into the wind
            slow_m_s.append(speed_m_s - ahead_m_s + max(0.0, -blows.real))
        return max([0.0, *slow_m_s])


def in_battery(number: int | None) -> str:
    """A phrase that names a battery; "" for the only one."""
    return f" in battery {number}" if number else ""


def least_margin(
    left: Mapping[int, tuple[float, float | None]],
    facts: EnergyFacts,
    reserve: Reserve,
    *,
    home_s: float = 0.0,
    guessed: tuple[str, ...] = (),
) -> Margin | None:
    """The least margin of some batteries, from the charge and rate of loss of each; None without any."""
    margins = (
        Margin(
            percent,
            rate_percent_s=rate,
            home_s=home_s,
            reserve=reserve,
            low_percent=facts.low_percent_of(number),
            guessed=guessed,
            battery=number if len(left) > 1 else None,
        )
        for number, (percent, rate) in left.items()
    )
    return min(margins, key=lambda margin: margin.percent, default=None)


@dataclass(slots=True)
class FlightEnergy:
    """Follows a flight by its reports; `margin` is the margin over the way home, in percent of a battery.

    Of several batteries the one with the least margin counts. A battery that falls silent drains on as before.
    """

    reserve: Reserve
    endurance_s: float | None = None
    lands: bool = False  # where it is, instead of returning home
    _batteries: dict[int, Consumption] = field(init=False, default_factory=dict)
    _wind: Wind = field(init=False, default_factory=Wind)

    def take(self, report: FlightReport) -> None:
        """Takes in a report of a vehicle in flight; times never go back."""
        for number, percent in report.charges_percent.items():
            if number not in self._batteries:
                self._batteries[number] = Consumption(self.endurance_s)
            self._batteries[number].take(report.time_s, percent)
        self._wind.take(report)

    def margin(
        self, report: FlightReport, home: Position, facts: EnergyFacts, *, down_s: float | None = None
    ) -> Margin | None:
        """The margin now; None before the first battery report. `home` stands in for an unreported home.

        `down_s` are the seconds to the ground where the vehicle comes down already.
        """
        if down_s is None:
            down_s = LOOK_S + self._down_s(report, home, facts)
        left = {
            number: (flown.left_percent(report.time_s), flown.rate_percent_s)
            for number, flown in self._batteries.items()
        }
        return least_margin(left, facts, self.reserve, home_s=down_s, guessed=facts.guessed)

    def standing_margin(self, charges_percent: Mapping[int, float], facts: EnergyFacts) -> Margin | None:
        """The margin before the flight; None without a charge."""
        rate = Consumption(self.endurance_s).rate_percent_s
        left = {number: (percent, rate) for number, percent in charges_percent.items()}
        return least_margin(left, facts, self.reserve)

    def _down_s(self, report: FlightReport, home: Position, facts: EnergyFacts) -> float:
        """Seconds to the ground; a return ends at the farther of the places chosen here and where it could stop."""
        if self.lands:
            way = facts.way_home or UNKNOWN
            return way.hover_s + descent_s(report.position.altitude_m, way)
        velocity = report.velocity or STILL
        stopping_s = LOOK_S + velocity.speed_m_s / (facts.way_home or UNKNOWN).acceleration_m_s2
        beyond = ahead(report.position, velocity, stopping_s)
        longest_s = 0.0
        for place in {facts.returns_to(here, otherwise=home) for here in (report.position, beyond)}:
            way, end = facts.way_to(place), place.position
            against_m_s = self._wind.against_m_s(report.position, end, way.speed_m_s)
            home_s = time_home_s(report.position, end, way, against_m_s=against_m_s, velocity=velocity)
            longest_s = max(longest_s, home_s)
        return longest_s
