"""When a flight has to turn back: held against recorded returns, and against flights that turn back when told."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import structs

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.energy import Consumption, FlightEnergy, FlightReport, Margin, Reserve, Wind
from upwash.core.vehicle.way_home import ARDUCOPTER, PX4, STILL, EnergyFacts, WayHome, descent_s, time_home_s

HOME = Position(0.0, 0.0)
RETURNS = Path(__file__).parent / "data/returns.csv"

positions = st.builds(Position, st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 120))
winds = st.builds(Velocity, st.floats(-15, 15), st.floats(-15, 15))
ways = st.sampled_from([ARDUCOPTER, PX4])
percents = st.floats(0, 100)
rates = st.floats(0.001, 1.0)
reserves = st.builds(Reserve, st.floats(0, 300), st.none() | st.floats(1, 50))
stages = st.none() | st.floats(0, 40)


def recorded_returns() -> Iterator[tuple[WayHome, Position, Velocity, float]]:
    with RETURNS.open() as file:
        for row in csv.DictReader(file):
            yield (
                {"arducopter": ARDUCOPTER, "px4": PX4}[row["vehicle"]],
                Position(float(row["away_m"]), 0.0, float(row["altitude_m"])),
                Velocity(float(row["speed_m_s"])),
                float(row["took_s"]),
            )


@pytest.mark.parametrize(("way", "start", "velocity", "took_s"), list(recorded_returns()))
def test_no_recorded_return_took_longer_than_expected_nor_much_less(
    way: WayHome, start: Position, velocity: Velocity, took_s: float
) -> None:
    expected_s = time_home_s(start, HOME, way, velocity=velocity)
    assert took_s <= expected_s <= 1.3 * took_s


def test_what_is_guessed_is_among_the_words_of_a_margin() -> None:
    energy = FlightEnergy(Reserve(60.0), endurance_s=1000.0)
    report = FlightReport(0.0, HOME, {1: 50.0})
    energy.take(report)
    known = energy.margin(report, HOME, EnergyFacts(way_home=PX4))
    guessed = energy.margin(report, HOME, EnergyFacts(way_home=PX4, guessed=("RTL_ALT",)))
    assert str(guessed) == f"{known} (guessed: RTL_ALT is not known)"


def test_the_way_home_is_the_sum_of_its_parts() -> None:
    way = WayHome(
        altitude_m=30.0, climb_m_s=2.0, speed_m_s=10.0, acceleration_m_s2=1.0, hover_s=5.0, descent_m_s=2.0,
        slowly_below_m=10.0, landing_m_s=0.5,
    )  # fmt: skip
    climb_s, way_s, down_s = 20 / 2 + 2, 400 / 10 + 10, 20 / 2 + 2 + 10 / 0.5
    assert time_home_s(Position(400, 0, 10), HOME, way) == climb_s + way_s + 5.0 + down_s
    assert time_home_s(Position(400, 0, 10), HOME, way, against_m_s=5.0) == climb_s + 85.0 + 5.0 + down_s
    storm_s = time_home_s(Position(400, 0, 10), HOME, way, against_m_s=9.0)
    assert storm_s == pytest.approx(climb_s + 400 / (10 / 3) + 10 / 3 + 5.0 + down_s)
    leaving_s = time_home_s(Position(384, 0, 10), HOME, way, velocity=Velocity(4.0))
    assert leaving_s == 4.0 + climb_s + way_s + 5.0 + down_s, "2 s at 4 m/s, and 8 m to stop"
    agile = structs.replace(way, acceleration_m_s2=2.0)
    standing_s, flying_s = (
        time_home_s(Position(east_m, 0, 10), HOME, agile, velocity=Velocity(speed_m_s))
        for east_m, speed_m_s in ((400, 0.0), (388, 4.0))
    )
    assert flying_s == standing_s + 2.0, "2 s at 4 m/s, and 4 m to stop in 2 s"
    assert time_home_s(Position(400, 0, 50), HOME, way) == way_s + 5.0 + descent_s(50.0, way)
    assert descent_s(30.0, way) == down_s
    assert descent_s(5.0, way) == 10.0
    assert descent_s(-1.0, way) == 0.0


# --- more wind, more distance, less battery never delay the return ------------------------------------------


@given(
    start=positions,
    way=ways,
    against_m_s=st.floats(0, 30),
    further=st.floats(1, 3),
    more_m_s=st.floats(0, 10),
)
def test_a_longer_way_and_more_wind_never_take_less_time(
    start: Position, way: WayHome, against_m_s: float, further: float, more_m_s: float
) -> None:
    near_s = time_home_s(start, HOME, way, against_m_s=against_m_s)
    away = Position(start.east_m * further, start.north_m * further, start.altitude_m)
    assert near_s <= time_home_s(away, HOME, way, against_m_s=against_m_s) + 1e-9
    assert near_s <= time_home_s(start, HOME, way, against_m_s=against_m_s + more_m_s) + 1e-9
    assert (
        near_s <= time_home_s(start, HOME, way, against_m_s=against_m_s, velocity=Velocity(more_m_s)) + 1e-9
    )


@given(
    percent=percents, less=percents, rate=rates, more=rates, home_s=st.floats(0, 600), longer_s=st.floats(0, 600),
    reserve=reserves, low=stages,
)  # fmt: skip
def test_less_battery_a_higher_rate_and_a_longer_way_never_leave_more_to_spare(
    *, percent: float, less: float, rate: float, more: float, home_s: float, longer_s: float, reserve: Reserve,
    low: float | None,
) -> None:  # fmt: skip
    now = Margin(percent, rate_percent_s=rate, home_s=home_s, reserve=reserve, low_percent=low)
    for worse in (
        Margin(percent - less, rate_percent_s=rate, home_s=home_s, reserve=reserve, low_percent=low),
        Margin(percent, rate_percent_s=rate + more, home_s=home_s, reserve=reserve, low_percent=low),
        Margin(percent, rate_percent_s=rate, home_s=home_s + longer_s, reserve=reserve, low_percent=low),
        Margin(percent, rate_percent_s=rate, home_s=home_s, reserve=reserve, low_percent=(low or 0) + less),
    ):
        assert worse.percent <= now.percent
        assert worse.turn_back or not now.turn_back


@given(start=positions, wind=winds, stronger=st.floats(1, 3), speed_m_s=st.floats(1, 15))
def test_more_wind_of_the_same_direction_never_takes_less(
    start: Position, wind: Velocity, stronger: float, speed_m_s: float
) -> None:
    def against(wind: Velocity) -> float:
        seen = Wind()
        seen.take(FlightReport(0.0, start, wind=wind))
        return seen.against_m_s(start, HOME, speed_m_s)

    more = Velocity(wind.east_m_s * stronger, wind.north_m_s * stronger)
    assert 0.0 <= against(wind) <= against(more) + 1e-9


@given(
    falls=st.lists(st.integers(-1, 2), min_size=1, max_size=400), less=st.integers(0, 20),
    endurance_s=st.none() | st.floats(300, 3000),
)  # fmt: skip
def test_a_battery_that_is_emptier_now_never_lasts_longer(
    falls: list[int], less: int, endurance_s: float | None
) -> None:
    usual, emptier = Consumption(endurance_s), Consumption(endurance_s)
    percent = 90.0
    for second, fall in enumerate(falls):
        percent = min(100.0, max(0.0, percent - (fall if second % 10 == 0 else 0)))
        last = second == len(falls) - 1
        usual.take(float(second), percent)
        emptier.take(float(second), percent - (less if last else 0))
    assert (emptier.rate_percent_s or 0.0) >= (usual.rate_percent_s or 0.0)


# --- consumption --------------------------------------------------------------------------------------------


@given(
    rate=st.floats(0.02, 0.3),
    full=st.floats(60, 100),
    flown_s=st.integers(60, 400),
    lost=st.sets(st.integers(1, 400)),
)
def test_what_is_measured_is_never_less_than_what_is_used(
    rate: float, full: float, flown_s: int, lost: set[int]
) -> None:
    consumption = Consumption()
    for second in range(flown_s + 1):
        known = second in (0, flown_s) or second not in lost
        consumption.take(float(second), max(0.0, math.floor(full - rate * second)) if known else None)
    if full - rate * flown_s < 1:
        return
    measured = consumption.rate_percent_s
    assert measured is not None
    assert rate <= measured + 1e-9
    assert measured <= rate + 2 / min(flown_s, 180) + 1e-9, "a percent at each end is all that steps hide"


def test_before_enough_is_flown_the_configured_endurance_counts() -> None:
    known, unknown = Consumption(500.0), Consumption()
    for consumption in (known, unknown):
        for second in range(59):
            consumption.take(float(second), 90.0 - second)
    assert known.rate_percent_s == 0.2
    assert unknown.rate_percent_s is None
    unknown.take(60.0, 30.0)
    assert unknown.rate_percent_s == pytest.approx(61 / 60)


def test_a_battery_that_is_never_reported_tells_nothing() -> None:
    silent = Consumption()
    for second in range(300):
        silent.take(float(second), None)
    assert silent.rate_percent_s is None
    energy = FlightEnergy(Reserve(60.0))
    energy.take(FlightReport(0.0, HOME))
    assert energy.margin(FlightReport(0.0, HOME), HOME, EnergyFacts()) is None


def test_a_battery_that_was_swapped_is_measured_anew_and_until_then_believed_no_better() -> None:
    consumption = Consumption()
    for second in range(301):
        consumption.take(float(second), float(math.floor(90 - second * 0.2)))
    before = consumption.rate_percent_s
    assert before == pytest.approx(0.2, abs=0.007)
    for second in range(301, 481):
        consumption.take(float(second), float(math.floor(100 - (second - 301) * 0.1)))
        assert consumption.rate_percent_s == pytest.approx(before)
    for second in range(481, 700):
        consumption.take(float(second), float(math.floor(100 - (second - 301) * 0.1)))
        assert consumption.rate_percent_s == pytest.approx(
            0.1, abs=0.012
        )  # a percent more or less, each second
    assert consumption.rate_percent_s == pytest.approx(0.1, abs=0.007)


def test_a_battery_that_was_swapped_soon_and_one_that_rises_say_nothing_yet() -> None:
    swapped, rising = Consumption(), Consumption()
    for time_s, percent in ((0.0, 50.0), (10.0, 100.0)):
        swapped.take(time_s, percent)
    for time_s, percent in ((0.0, 80.0), (100.0, 82.0)):
        rising.take(time_s, percent)
    assert swapped.rate_percent_s is rising.rate_percent_s is None


def test_a_rise_of_three_percent_is_no_other_battery_and_one_of_more_is() -> None:
    rates = []
    for risen in (83.0, 84.0):
        consumption = Consumption()
        for time_s, percent in ((0.0, 100.0), (100.0, 80.0), (200.0, risen), (400.0, risen)):
            consumption.take(time_s, percent)
        rates.append(consumption.rate_percent_s)
    assert rates == [pytest.approx((100 - 83 + 1) / 400), pytest.approx(1 / 200)]


def test_the_last_three_minutes_begin_at_the_report_before_them() -> None:
    consumption = Consumption()
    for time_s, percent in ((0.0, 100.0), (120.0, 98.0), (300.0, 50.0)):
        consumption.take(time_s, percent)
    assert consumption.rate_percent_s == pytest.approx((98 - 50 + 1) / 180)


def test_a_rise_by_a_step_is_no_other_battery() -> None:
    consumption = Consumption()
    for second in range(301):
        consumption.take(float(second), float(math.floor(90 - second * 0.2) + second % 2))
    assert consumption.rate_percent_s == pytest.approx(0.2, abs=0.015)


# --- wind ---------------------------------------------------------------------------------------------------


def flown_east(told_m_s: float, ground_m_s: float, seconds: int = 10, up_m_s: float = 0.0) -> Wind:
    wind = Wind()
    for second in range(seconds):
        velocity = Velocity(ground_m_s, 0.0, up_m_s)
        wind.take(FlightReport(float(second), HOME, velocity=velocity, leg_speed_m_s=told_m_s))
    return wind


def test_a_leg_that_was_slow_tells_of_the_wind_in_its_direction_only() -> None:
    wind = flown_east(told_m_s=8.0, ground_m_s=5.0)
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 3.0
    assert wind.against_m_s(HOME, Position(100, 100), 10.0) == pytest.approx(3.0 / math.sqrt(2))
    assert wind.against_m_s(HOME, Position(0, 100), 10.0) == 0.0
    assert wind.against_m_s(HOME, Position(-100, 0), 10.0) == 0.0
    assert wind.against_m_s(HOME, HOME, 10.0) == 3.0, "at most so much: in which direction is not known"


def test_what_is_slow_for_another_reason_tells_nothing() -> None:
    slow = [
        Wind(),
        flown_east(8.0, 5.0, seconds=3),  # too short
        flown_east(8.0, 5.0, up_m_s=1.0),  # steep
        flown_east(8.0, 5.0, up_m_s=-1.0),
        flown_east(8.0, 0.1),  # it stands
        flown_east(8.0, 9.0),  # it is fast
    ]
    speeding_up = Wind()
    for second in range(8):
        speeding_up.take(FlightReport(float(second), HOME, velocity=Velocity(second), leg_speed_m_s=8.0))
    holding = Wind()
    for second in range(8):
        holding.take(FlightReport(float(second), HOME, velocity=Velocity(5.0)))
    restless, hurried = Wind(), Wind()
    for second in range(8):
        velocity = Velocity(5.0 + second % 2 / 2)
        restless.take(FlightReport(float(second), HOME, velocity=velocity, leg_speed_m_s=8.0))
        velocity = Velocity(5.0)
        hurried.take(FlightReport(float(second), HOME, velocity=velocity, leg_speed_m_s=8.0 + second % 2))
    for wind in (*slow, speeding_up, holding, restless, hurried):
        assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 0.0
        assert wind.against_m_s(HOME, HOME, 10.0) == 0.0


def test_a_leg_is_steady_anew_after_a_report_without_it() -> None:
    wind = Wind()
    for second in range(6):
        told_m_s = None if second == 2 else 8.0
        wind.take(FlightReport(float(second), HOME, velocity=Velocity(5.0), leg_speed_m_s=told_m_s))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 0.0
    wind.take(FlightReport(6.0, HOME, velocity=Velocity(5.0), leg_speed_m_s=8.0))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 3.0


def test_a_leg_is_level_and_steady_within_its_bounds() -> None:
    swaying = Wind()
    for second in range(8):
        velocity = Velocity(5.0, 0.3 * (second % 2))
        swaying.take(FlightReport(float(second), HOME, velocity=velocity, leg_speed_m_s=8.0))
    assert swaying.against_m_s(HOME, Position(100, 0), 10.0) == pytest.approx(3.0, abs=0.05)
    for wind, lost_m_s in (
        (flown_east(8.0, 5.0, up_m_s=0.3), 3.0),
        (flown_east(8.0, 5.0, seconds=4), 3.0),
        (flown_east(8.0, 0.5), 7.5),
        (flown_east(8.0, 1.0), 7.0),
    ):
        assert wind.against_m_s(HOME, Position(100, 0), 10.0) == lost_m_s


def test_a_slow_leg_is_forgotten_in_time() -> None:
    wind = flown_east(8.0, 5.0)
    wind.take(FlightReport(609.0, HOME))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 3.0
    wind.take(FlightReport(609.1, HOME))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 0.0


def test_a_reported_wind_counts_by_its_direction_and_never_as_a_help() -> None:
    wind = Wind()
    wind.take(FlightReport(0.0, HOME, wind=Velocity(-6.0, 0.0)))
    wind.take(FlightReport(1.0, HOME))  # a report without it
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 6.0
    assert wind.against_m_s(HOME, Position(-100, 0), 10.0) == 0.0
    assert wind.against_m_s(HOME, Position(0, 100), 10.0) == pytest.approx(
        2.0
    )  # 8 of 10 m/s are left, across it
    wind.take(FlightReport(1.5, HOME, wind=Velocity(-3.0, -4.0)))
    slower_m_s = 7.0 / math.sqrt(2) + 10.0 - math.sqrt(100.0 - 0.5)
    assert wind.against_m_s(HOME, Position(100, 100), 10.0) == pytest.approx(slower_m_s)
    wind.take(FlightReport(2.0, HOME, wind=Velocity(0.0, -12.0)))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 10.0, "nothing is left"
    assert wind.against_m_s(HOME, HOME, 10.0) == 12.0


def test_the_worse_of_report_and_legs_counts() -> None:
    wind = flown_east(8.0, 5.0)
    wind.take(FlightReport(10.0, HOME, wind=Velocity(-1.0)))
    assert wind.against_m_s(HOME, Position(100, 0), 10.0) == 3.0


# --- whole flights ------------------------------------------------------------------------------------------


@given(
    way=ways, rate=st.floats(0.03, 0.25), full=st.floats(50, 100), speed_m_s=st.floats(1, 12),
    altitude_m=st.floats(5, 60), angle=st.floats(0, math.tau), wind=winds, told=st.booleans(),
    reserve=reserves, low=stages, endurance=st.floats(0.3, 1.0),
)  # fmt: skip
@example(  # with little to spare between one look at the battery and the next
    way=PX4, rate=0.25, full=50.0, speed_m_s=6.0, altitude_m=5.0, angle=0.0, wind=Velocity(0.0, 4.0), told=True,
    reserve=Reserve(3.0, None), low=None, endurance=1.0,
)  # fmt: skip
@example(  # from home, where the wind of the way back is not known yet
    way=PX4, rate=0.21875, full=55.0, speed_m_s=5.0, altitude_m=5.0, angle=0.0, wind=Velocity(0.0, 5.0), told=True,
    reserve=Reserve(0.0, None), low=39.0, endurance=1.0,
)  # fmt: skip
def test_a_flight_that_turns_back_when_told_arrives_with_at_least_the_reserve(
    *, way: WayHome, rate: float, full: float, speed_m_s: float, altitude_m: float, angle: float, wind: Velocity,
    told: bool, reserve: Reserve, low: float | None, endurance: float,
) -> None:  # fmt: skip
    """Straight away from home until told; the vehicle then loses to the wind what a slow leg, or a report, said.

    It looks once a second, and is told a second later: together the 2 s that the way home is expected to begin with.
    """
    facts = EnergyFacts(low_percent=low, way_home=way)
    energy = FlightEnergy(reserve, endurance_s=endurance * 100 / rate)
    east, north = math.cos(angle), math.sin(angle)
    for second in range(3600):
        left = full - rate * second
        here = Position(east * speed_m_s * second, north * speed_m_s * second, altitude_m)
        report = FlightReport(
            float(second), here, {1: float(math.floor(left))}, Velocity(east * speed_m_s, north * speed_m_s),
            speed_m_s, wind if told else None,
        )  # fmt: skip
        energy.take(report)
        now = energy.margin(report, HOME, facts)
        assert now is not None
        if now.turn_back:
            break
    else:
        raise AssertionError("it flew for ever")
    if second == 0:
        return  # too little was left for any flight
    seen = Wind()
    seen.take(FlightReport(0.0, here, wind=wind if told else STILL))
    against_m_s = seen.against_m_s(here, HOME, way.speed_m_s)
    before = Position(here.east_m - east * speed_m_s, here.north_m - north * speed_m_s, altitude_m)
    takes_s = 1.0 + time_home_s(before, HOME, way, against_m_s=against_m_s, velocity=Velocity(speed_m_s))
    at_touchdown = left - rate * takes_s
    assert at_touchdown >= max(rate * reserve.seconds, low or 0.0, reserve.percent or 0.0) - 1e-6


def test_the_vehicle_says_where_it_returns_to() -> None:
    energy = FlightEnergy(Reserve(60.0), endurance_s=1000.0)
    report = FlightReport(0.0, Position(400, 0, 30), {1: 50.0})
    energy.take(report)
    far = energy.margin(report, HOME, EnergyFacts(way_home=PX4))
    near = energy.margin(report, HOME, EnergyFacts(way_home=PX4, home=Position(400, 0)))
    assert far is not None and near is not None
    assert far.home_s > near.home_s + 80.0


def test_a_flight_that_ends_where_it_is_needs_the_way_down_only() -> None:
    energy = FlightEnergy(Reserve(60.0), endurance_s=1000.0, lands=True)
    report = FlightReport(0.0, Position(400, 0, 30), {1: 50.0})
    energy.take(report)
    now = energy.margin(report, HOME, EnergyFacts(way_home=PX4))
    assert now is not None
    assert now.home_s == 2.0 + PX4.hover_s + descent_s(30.0, PX4)


def test_a_battery_that_empties_faster_than_configured_is_measured() -> None:
    energy = FlightEnergy(Reserve(60.0), endurance_s=1000.0)
    for time_s, percent in ((0.0, 90.0), (100.0, 60.0)):
        energy.take(FlightReport(time_s, HOME, {1: percent}))
    now = energy.margin(FlightReport(100.0, HOME), HOME, EnergyFacts())
    assert now is not None
    assert now.rate_percent_s == pytest.approx(31 / 100)


def test_while_no_report_comes_the_battery_is_believed_to_empty_as_before() -> None:
    energy = FlightEnergy(Reserve(60.0), endurance_s=1000.0)
    energy.take(FlightReport(100.0, HOME, {1: 50.0}))
    for second in range(101, 131):
        energy.take(FlightReport(float(second), HOME))
    now = energy.margin(FlightReport(130.0, HOME), HOME, EnergyFacts())
    assert now is not None
    assert now.left_percent == pytest.approx(47.0)


def test_of_several_batteries_the_one_with_the_least_margin_counts() -> None:
    energy = FlightEnergy(Reserve(60.0))
    for second in range(121):  # the second one drains four times as fast, from more
        energy.take(FlightReport(float(second), HOME, {1: 60.0 - second * 0.05, 2: 100.0 - second * 0.2}))
    facts = EnergyFacts(way_home=PX4)
    far = energy.margin(FlightReport(120.0, Position(400, 0, 30)), HOME, facts)
    assert far is not None
    assert far.battery == 2, "it has more, and loses more on the way home"
    assert far.left_percent == pytest.approx(76.0)
    near = energy.margin(FlightReport(120.0, HOME), HOME, facts, down_s=1.0)
    assert near is not None
    assert near.battery == 1
    for second in range(121, 301):
        energy.take(FlightReport(float(second), HOME, {1: 60.0 - second * 0.05, 2: 100.0 - second * 0.2}))
    low = energy.margin(FlightReport(300.0, Position(400, 0, 30)), HOME, facts)
    assert low is not None
    assert low.battery == 2
    assert low.left_percent == pytest.approx(40.0)
    assert low.rate_percent_s == pytest.approx(0.2, abs=0.02)
    assert str(low).endswith("40 % is left in battery 2")


def test_a_battery_that_falls_silent_drains_on_as_before() -> None:
    energy = FlightEnergy(Reserve(60.0))
    for second in range(121):
        energy.take(FlightReport(float(second), HOME, {1: 90.0, 2: 80.0 - second * 0.2}))
    for second in range(121, 241):
        energy.take(FlightReport(float(second), HOME, {1: 90.0}))
    now = energy.margin(FlightReport(240.0, HOME), HOME, EnergyFacts())
    assert now is not None
    assert now.battery == 2
    assert now.left_percent == pytest.approx(32.0, abs=2.0)


@pytest.mark.parametrize(("stages", "battery"), [({}, 1), ({2: 30.0}, 2), ({2: None}, 1)])
def test_each_battery_has_its_own_low_stage(stages: dict[int, float | None], battery: int) -> None:
    energy = FlightEnergy(Reserve(0.0))
    facts = EnergyFacts(low_percent=20.0, low_percents=stages)
    now = energy.standing_margin({1: 50.0, 2: 55.0}, facts)
    assert now is not None
    assert now.battery == battery


@pytest.mark.parametrize(
    ("reserve", "low", "said"),
    [
        (Reserve(60.0), None, "81 s to home need 12 %, 60 s of reserve 9 %, 20 % is left"),
        (Reserve(60.0, 15.0), None, "81 s to home need 12 %, the reserve is 15 %, 20 % is left"),
        (
            Reserve(60.0, 15.0),
            18.0,
            "81 s to home need 12 %, the vehicle's own low-battery stage is at 18 %, 20 % is left",
        ),
    ],
)
def test_it_says_its_numbers(reserve: Reserve, low: float | None, said: str) -> None:
    now = Margin(20.4, rate_percent_s=0.15, home_s=81.0, reserve=reserve, low_percent=low)
    assert str(now) == said
    assert now.turn_back


def test_without_a_rate_the_percent_that_must_be_left_still_counts() -> None:
    now = Margin(16.0, rate_percent_s=None, home_s=81.0, reserve=Reserve(60.0, 15.0))
    assert str(now) == "81 s to home need what is not known yet, the reserve is 15 %, 16 % is left"
    assert now.percent == 1.0


def test_what_is_left_is_enough_until_it_is_less() -> None:
    for left, turns_back in ((15.0, False), (14.9, True)):
        now = Margin(left, rate_percent_s=None, home_s=81.0, reserve=Reserve(60.0, 15.0))
        assert now.turn_back == turns_back
