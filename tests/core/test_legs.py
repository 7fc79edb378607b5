"""How long legs take, against plain reckoning and against the vehicle model that flies them in simulation."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position, Waypoint, ground_distance_m
from upwash.core.operation import Operation
from upwash.core.planning.legs import Leg, Pace, acceleration_m_s2, entered_m, left_m
from upwash.core.planning.mission_model import ExpectedCall, MissionBeliefs, MissionModel, StopCall
from upwash.vehicle.body.kinematics import Motion, braking, duration_s, leg

lengths_m = st.floats(0.5, 500.0)
speeds_m_s = st.floats(0.5, 20.0)
accelerations_m_s2 = st.floats(0.1, 10.0)
coordinates_m = st.floats(-200.0, 200.0)
positions = st.builds(Position, coordinates_m, coordinates_m, st.sampled_from([20.0]))


def test_a_long_leg_cruises_and_a_short_one_does_not() -> None:
    assert Leg(20.0, 4.0, 1.0).duration_s == 9.0  # 4 s and 8 m to speed up, 1 s at speed, 4 s to brake
    assert Leg(4.0, 4.0, 1.0).duration_s == 4.0
    assert Leg(0.0, 4.0, 1.0, settling_s=2.0).duration_s == 0.0
    assert Leg(20.0, 4.0, 1.0, settling_s=2.0).duration_s == 11.0


def test_the_vehicle_has_come_half_way_in_half_the_time() -> None:
    assert Leg(20.0, 4.0, 1.0).reached_s(10.0) == 4.5
    assert Leg(20.0, 4.0, 1.0).reached_s(-1.0) == 0.0
    assert Leg(20.0, 4.0, 1.0).reached_s(21.0) == 9.0
    assert Leg(20.0, 4.0, 1.0, settling_s=2.0).reached_s(20.0) == 9.0, "it settles at its target"


def test_before_its_start_and_after_its_end_a_leg_goes_no_further() -> None:
    assert [Leg(20.0, 4.0, 1.0).travelled_m(time_s) for time_s in (-1.0, 0.0, 9.0, 100.0)] == [
        0.0,
        0.0,
        20.0,
        20.0,
    ]
    nowhere = Leg(0.0, 4.0, 1.0)
    assert (nowhere.reached_s(1.0), nowhere.travelled_m(1.0), nowhere.back_s(1.0)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("duration_s", "found_m_s2"), [(20.0, 0.05), (20.1, None), (0.64, 50.0), (0.63, None)]
)
def test_an_acceleration_that_no_vehicle_has_is_not_learnt(
    duration_s: float, found_m_s2: float | None
) -> None:
    found = acceleration_m_s2(5.0 if duration_s > 1 else 5.12, 100.0, duration_s)
    assert found == (None if found_m_s2 is None else pytest.approx(found_m_s2))


def test_a_take_off_takes_its_lifting_and_its_climb() -> None:
    pace = Pace(lifting_s=3.0, climb_m_s=2.0)
    assert [pace.takeoff_s(altitude_m) for altitude_m in (-1.0, 0.0, 20.0)] == [3.0, 3.0, 13.0]


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


HEAVY = Operation("detector", "process_photo", "heavy")
DIRT = Operation("dirt", "measure")
PLACES = [Position(20.0 * number, 0.0, 20.0) for number in range(5)]
AREAS = {"near": Circle(Position(0.0, 0.0), 25.0), "far": Circle(Position(70.0, 0.0), 40.0)}
LEG_S, PHOTO_S = 9.0, 1.0  # 20 m at 4 m/s and 1 m/s²


def mission_model(*, speeds_m_s: dict[int, float] | None = None) -> MissionModel:
    plan = [Waypoint(number, place, (speeds_m_s or {}).get(number)) for number, place in enumerate(PLACES)]
    return MissionModel(MissionBeliefs(plan, 4.0, Pace(1.0), [StopCall(HEAVY, PHOTO_S)]), AREAS)


def gaps_s(calls: list[ExpectedCall]) -> list[float]:
    return [round(call.gap_s, 9) for call in calls]


def at_first(*, now_s: float = 0.0) -> MissionModel:
    """Snapshot at the first waypoint since that time."""
    expected = mission_model()
    expected.leg_begun(PLACES[0], PLACES[0], None, now_s=now_s)
    expected.arrived(now_s=now_s)
    return expected


def test_nothing_is_expected_before_the_first_leg_nor_when_the_course_is_lost() -> None:
    expected = mission_model()
    assert expected.coming(PLACES[0], now_s=0.0, count=20) == []
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=0.0)
    expected.lost()
    assert expected.coming(PLACES[0], now_s=1.0, count=20) == []


def test_every_waypoint_to_come_has_a_call_after_its_leg_and_photo() -> None:
    calls = at_first().coming(PLACES[0], now_s=0.0, count=20)
    assert gaps_s(calls) == [PHOTO_S, *[LEG_S + PHOTO_S] * 4]
    assert {call.operation for call in calls} == {HEAVY}
    assert len(at_first().coming(PLACES[0], now_s=0.0, count=3)) == 3


def test_a_range_counts_from_where_it_is_entered_on_the_way() -> None:
    calls = at_first().coming(PLACES[0], now_s=0.0, count=20)
    assert [sorted(call.in_range_s) for call in calls] == [["near"], ["near"], ["far"], ["far"], ["far"]]
    assert calls[1].in_range_s["near"] == calls[1].gap_s
    # The range begins at 30 m: half of the leg from 20 to 40 m takes 4.5 s, and the photo 1 s.
    assert calls[2].in_range_s["far"] == pytest.approx(4.5 + PHOTO_S)
    assert calls[3].in_range_s["far"] == calls[3].gap_s


def test_a_range_that_a_leg_hardly_enters_counts_for_the_rest_of_the_leg_and_a_short_photo() -> None:
    plan = [Waypoint(number, place) for number, place in enumerate(PLACES[:3])]
    areas = {"far": Circle(Position(70.0, 0.0), 30.1)}
    expected = MissionModel(MissionBeliefs(plan, 4.0, Pace(1.0), [StopCall(HEAVY, 0.1)]), areas)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=0.0)
    last = expected.coming(PLACES[0], now_s=0.0, count=9)[-1]
    assert last.in_range_s["far"] == pytest.approx(0.2**0.5 + 0.1)


def test_holds_of_the_plan_count_before_the_calls_of_their_stops() -> None:
    hold_s = 5.0
    plan = [Waypoint(number, place, hold_s=hold_s) for number, place in enumerate(PLACES)]
    expected = MissionModel(MissionBeliefs(plan, 4.0, Pace(1.0), [StopCall(HEAVY, PHOTO_S)]), AREAS)
    expected.leg_begun(PLACES[0], PLACES[0], None, now_s=0.0)
    held_s = hold_s + PHOTO_S
    assert gaps_s(expected.coming(PLACES[0], now_s=0.0, count=2)) == [held_s, LEG_S + held_s]
    expected.arrived(now_s=0.0)
    calls = expected.coming(PLACES[0], now_s=2.0, count=3)
    assert gaps_s(calls) == [held_s - 2.0, LEG_S + held_s, LEG_S + held_s]
    assert calls[2].in_range_s["far"] == pytest.approx(4.5 + held_s)
    expected.call_begun(HEAVY, now_s=held_s)
    expected.call_ends(held_s + 10.0)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=held_s + 10.0)
    half_way = Position(10.0, 0.0, 20.0)
    in_flight = gaps_s(expected.coming(half_way, now_s=held_s + 14.5, count=2))
    assert in_flight == [
        4.5 + held_s,
        LEG_S + held_s,
    ]  # the hold is no part of what a stop is expected to be like


def test_in_flight_what_is_left_of_the_leg_counts() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(11.0)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=11.0)
    half_way = Position(10.0, 0.0, 20.0)
    assert gaps_s(expected.coming(half_way, now_s=15.5, count=2)) == [4.5 + PHOTO_S, LEG_S + PHOTO_S]


def test_a_call_under_way_delays_the_next_one_by_what_is_left_of_it() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(11.0)
    assert gaps_s(expected.coming(PLACES[0], now_s=5.0, count=2)) == [6.0 + LEG_S + PHOTO_S, LEG_S + PHOTO_S]


def test_a_stop_is_expected_to_be_like_the_last_one() -> None:
    expected = at_first()
    for operation, begun_s, ends_s in ((HEAVY, 2.0, 12.0), (DIRT, 12.5, 20.0)):
        expected.call_begun(operation, now_s=begun_s)
        expected.call_ends(ends_s)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=23.0)
    expected.arrived(now_s=32.0)
    calls = expected.coming(PLACES[1], now_s=32.0, count=4)
    assert [call.operation for call in calls] == [HEAVY, DIRT, HEAVY, DIRT]
    assert gaps_s(calls) == [2.0, 0.5, 3.0 + LEG_S + 2.0, 0.5]


def test_the_time_before_a_leg_is_no_part_of_the_way_in_a_range() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(2.0)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=5.0)
    expected.arrived(now_s=14.0)
    _, following = expected.coming(PLACES[1], now_s=14.0, count=2)
    assert following.gap_s == pytest.approx(3.0 + LEG_S + PHOTO_S)
    assert following.in_range_s["far"] == pytest.approx(4.5 + PHOTO_S)


def test_after_a_stop_without_a_call_nothing_is_expected_of_the_others() -> None:
    expected = at_first()
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=5.0)
    assert expected.coming(PLACES[0], now_s=5.0, count=20) == []


def test_the_photo_of_this_stop_or_else_of_the_last_one_is_expected() -> None:
    assert MissionModel(MissionBeliefs(), {}).photo_s == 0.0
    expected = at_first()
    assert expected.photo_s == PHOTO_S
    expected.call_begun(HEAVY, now_s=2.0)
    assert expected.photo_s == 2.0


def test_a_call_under_way_is_over_when_it_was_expected_at_the_latest() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(11.0)
    assert [expected.open_s(now_s) for now_s in (5.0, 11.0, 12.0)] == [6.0, 0.0, 0.0]


def test_a_mission_that_is_late_is_expected_to_go_on_at_once() -> None:
    assert gaps_s(at_first().coming(PLACES[0], now_s=30.0, count=2)) == [0.0, LEG_S + PHOTO_S]
    called = at_first()
    called.call_begun(HEAVY, now_s=1.0)
    called.call_ends(11.0)
    assert gaps_s(called.coming(PLACES[0], now_s=30.0, count=1)) == [LEG_S + PHOTO_S]


def test_a_range_that_was_entered_counts_from_there_though_the_leg_goes_on() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(2.0)
    expected.leg_begun(PLACES[1], PLACES[2], None, now_s=2.0)
    (before,) = expected.coming(Position(25.0, 0.0, 20.0), now_s=5.0, count=1)
    assert before.gap_s == pytest.approx(LEG_S - 10.0**0.5 + PHOTO_S)
    assert before.in_range_s["far"] == pytest.approx(4.5 + PHOTO_S)
    (inside,) = expected.coming(Position(35.0, 0.0, 20.0), now_s=7.0, count=1)
    assert inside.in_range_s["far"] == inside.gap_s == pytest.approx(10.0**0.5 + PHOTO_S)


def test_the_next_leg_leads_to_the_next_waypoint_of_the_plan() -> None:
    expected = mission_model(speeds_m_s={3: 2.0})
    assert expected.next_leg() is None, "it has not begun"
    legs = []
    for number, place in enumerate(PLACES):
        expected.leg_begun(PLACES[max(0, number - 1)], place, None, now_s=20.0 * number)
        assert expected.next_leg() is None, "a leg is under way"
        expected.arrived(now_s=20.0 * number + LEG_S)
        following = expected.next_leg()
        if following is not None:
            assert isinstance(following.leg, Leg)
            legs.append((following.start, following.end, following.leg.ground_speed_m_s))
    speeds_m_s = (4.0, 4.0, 2.0, 4.0)
    assert legs == list(zip(PLACES, PLACES[1:], speeds_m_s, strict=False))
    expected.leg_begun(PLACES[4], Position(0.0, 20.0, 20.0), None, now_s=100.0)
    expected.arrived(now_s=109.0)
    assert expected.next_leg() is None, "it is off its plan"
    assert expected.rest(PLACES[0], now_s=109.0) == []


def test_a_place_that_is_visited_twice_is_the_later_one_on_the_second_visit() -> None:
    plan = [Waypoint(number, PLACES[place]) for number, place in enumerate((0, 1, 0, 2))]
    expected = MissionModel(MissionBeliefs(plan, 4.0, Pace(1.0), [StopCall(HEAVY, PHOTO_S)]), AREAS)
    left = []
    for place in (0, 1, 0, 1):
        expected.leg_begun(PLACES[0], PLACES[place], None, now_s=0.0)
        left.append(len(expected.rest(PLACES[0], now_s=0.0)))
    assert left == [4, 3, 2, 3], "the last leg goes back to an earlier place"


def test_a_way_back_teaches_nothing_and_has_no_hold() -> None:
    plan = [Waypoint(number, place, hold_s=5.0) for number, place in enumerate(PLACES)]
    expected = MissionModel(MissionBeliefs(plan, 4.0, Pace(1.0), [StopCall(HEAVY, PHOTO_S)]), AREAS)
    expected.leg_begun(PLACES[1], PLACES[0], None, now_s=0.0, back=True)
    expected.arrived(now_s=LEG_S)
    expected.leg_begun(PLACES[0], PLACES[1], None, now_s=LEG_S + 7.0)
    assert gaps_s(expected.coming(PLACES[0], now_s=LEG_S + 7.0, count=2)) == [
        LEG_S + 5.0 + PHOTO_S,
        LEG_S + 5.0 + PHOTO_S,
    ]


def test_the_acceleration_is_learnt_from_the_legs() -> None:
    expected = at_first()
    expected.call_begun(HEAVY, now_s=1.0)
    expected.call_ends(2.0)
    for number in (1, 2, 3):
        begun_s = 20.0 * number
        expected.leg_begun(PLACES[number - 1], PLACES[number], None, now_s=begun_s)
        expected.arrived(now_s=begun_s + 7.0)  # 2 s to speed up and to brake: 2 m/s²
        expected.call_begun(HEAVY, now_s=begun_s + 8.0)
        expected.call_ends(begun_s + 20.0)
    assert gaps_s(expected.coming(PLACES[3], now_s=80.0, count=1)) == [7.0 + PHOTO_S]


def test_the_speed_of_a_leg_may_be_its_own() -> None:
    expected = mission_model(speeds_m_s={2: 2.0})
    expected.leg_begun(PLACES[0], PLACES[1], 4.0, now_s=0.0)
    calls = expected.coming(PLACES[0], now_s=0.0, count=3)
    assert gaps_s(calls) == [LEG_S + PHOTO_S, 12.0 + PHOTO_S, 12.0 + PHOTO_S]


def test_off_the_plan_calls_are_expected_to_go_on_around_there() -> None:
    expected = mission_model()
    expected.leg_begun(PLACES[0], Position(0.0, 20.0, 20.0), None, now_s=0.0)
    calls = expected.coming(PLACES[0], now_s=0.0, count=4)
    assert gaps_s(calls) == [LEG_S + PHOTO_S] * 4
    assert [list(call.in_range_s) for call in calls] == [["near"]] * 4


def test_a_plan_that_is_left_and_taken_up_again_goes_on_from_there() -> None:
    expected = mission_model()
    expected.leg_begun(PLACES[0], Position(0.0, 20.0, 20.0), None, now_s=0.0)
    expected.arrived(now_s=9.0)
    expected.call_begun(HEAVY, now_s=10.0)
    expected.call_ends(11.0)
    expected.leg_begun(Position(0.0, 20.0, 20.0), PLACES[3], None, now_s=11.0)
    assert len(expected.coming(Position(0.0, 20.0, 20.0), now_s=11.0, count=20)) == 2
