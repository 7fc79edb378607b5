"""How long legs take, against plain reckoning and against the vehicle model that flies them in simulation."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.core.planning.legs import Leg, acceleration_m_s2, entered_m, left_m
from upwash.vehicle.body.kinematics import Motion, braking, duration_s, leg

lengths_m = st.floats(0.5, 500.0)
speeds_m_s = st.floats(0.5, 20.0)
accelerations_m_s2 = st.floats(0.1, 10.0)
coordinates_m = st.floats(-200.0, 200.0)
positions = st.builds(Position, coordinates_m, coordinates_m, st.sampled_from([20.0]))


def test_a_long_leg_cruises_and_a_short_one_does_not() -> None:
    assert Leg(20.0, 4.0, 1.0).duration_s == 9.0  # 4 s and 8 m to speed up, 1 s at speed, 4 s to brake
    assert Leg(4.0, 4.0, 1.0).duration_s == 4.0
    assert Leg(0.0, 4.0, 1.0).duration_s == 0.0


def test_the_vehicle_has_come_half_way_in_half_the_time() -> None:
    assert Leg(20.0, 4.0, 1.0).reached_s(10.0) == 4.5
    assert Leg(20.0, 4.0, 1.0).reached_s(-1.0) == 0.0
    assert Leg(20.0, 4.0, 1.0).reached_s(21.0) == 9.0


@given(length_m=lengths_m, speed_m_s=speeds_m_s, acceleration=accelerations_m_s2, share=st.floats(0.0, 1.0))
def test_it_is_where_the_simulated_vehicle_is(
    length_m: float, speed_m_s: float, acceleration: float, share: float
) -> None:
    expected = Leg(length_m, speed_m_s, acceleration)
    flown = leg(Position(0, 0), Position(length_m, 0), cruise_m_s=speed_m_s, acceleration_m_s2=acceleration)
    assert expected.duration_s == pytest.approx(duration_s(flown))
    travelled_m, left_s = 0.0, expected.reached_s(share * length_m)
    for phase in flown:
        travelled_m += phase.travelled_m(min(left_s, phase.duration_s))
        left_s = max(0.0, left_s - phase.duration_s)
    assert travelled_m == pytest.approx(share * length_m, abs=1e-3)


@given(length_m=lengths_m, speed_m_s=speeds_m_s, acceleration=accelerations_m_s2)
def test_the_acceleration_is_learnt_from_how_long_a_leg_took(
    length_m: float, speed_m_s: float, acceleration: float
) -> None:
    flown = Leg(length_m, speed_m_s, acceleration)
    assume(flown.duration_s > 1.01 * length_m / speed_m_s)
    found = acceleration_m_s2(length_m, speed_m_s, flown.duration_s)
    assert found == pytest.approx(acceleration, rel=1e-3)


@pytest.mark.parametrize(("length_m", "took_s"), [(0.0, 5.0), (20.0, 5.0), (20.0, 4.0), (20.0, 1e4)])
def test_a_leg_that_cannot_be_teaches_nothing(length_m: float, took_s: float) -> None:
    assert acceleration_m_s2(length_m, 4.0, took_s) is None


@given(start=positions, end=positions, centre=positions, radius_m=st.floats(1.0, 150.0))
def test_a_range_is_entered_once_and_kept(
    start: Position, end: Position, centre: Position, radius_m: float
) -> None:
    circle = Circle(centre, radius_m)
    way_m = entered_m(start, end, circle)
    assert (way_m is not None) == circle.contains(end)
    if way_m is None:
        return
    length_m = ground_distance_m(start, end)
    for place_m in (way_m + 0.01, (way_m + length_m) / 2):
        if way_m < place_m < length_m:
            assert Circle(centre, radius_m + 1e-3).contains(between(start, end, place_m / length_m))
    if way_m > 0.01:
        assert not Circle(centre, radius_m - 1e-3).contains(between(start, end, (way_m - 0.01) / length_m))


def between(start: Position, end: Position, share: float) -> Position:
    return Position(
        start.east_m + share * (end.east_m - start.east_m),
        start.north_m + share * (end.north_m - start.north_m),
    )


@given(length_m=lengths_m, speed_m_s=speeds_m_s, acceleration=accelerations_m_s2, share=st.floats(0.001, 1.0))
def test_the_way_back_is_what_the_simulated_vehicle_brakes_and_flies(
    length_m: float, speed_m_s: float, acceleration: float, share: float
) -> None:
    outward = Leg(length_m, speed_m_s, acceleration)
    start, end = Position(0, 0), Position(length_m, 0)
    motion = Motion(0.0, leg(start, end, cruise_m_s=speed_m_s, acceleration_m_s2=acceleration), end)
    elapsed_s = share * outward.duration_s
    here, velocity = motion.position(elapsed_s), motion.velocity(elapsed_s)
    assert outward.travelled_m(elapsed_s) == pytest.approx(here.east_m, abs=1e-6)
    stopping = braking(here, velocity, acceleration_m_s2=acceleration)
    stop = stopping[-1].end if stopping else here
    back = leg(stop, start, cruise_m_s=speed_m_s, acceleration_m_s2=acceleration)
    assert outward.back_s(elapsed_s) == pytest.approx(duration_s(stopping) + duration_s(back), abs=1e-4)


@given(start=positions, end=positions, centre=positions, radius_m=st.floats(1.0, 150.0))
def test_a_range_is_left_where_it_would_be_entered_on_the_way_back(
    start: Position, end: Position, centre: Position, radius_m: float
) -> None:
    circle = Circle(centre, radius_m)
    way_m = left_m(start, end, circle)
    assert (way_m is None) == circle.contains(end)
    if way_m is not None and not circle.contains(start):
        assert way_m == 0.0
    elif way_m is not None:
        assert ground_distance_m(between(start, end, way_m / ground_distance_m(start, end)), centre) == (
            pytest.approx(radius_m, abs=1e-6)
        )
