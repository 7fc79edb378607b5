"""Whether a vehicle can be where it reports: jumps, their ends, and what is no jump."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.continuity import Continuity

SPEED_M_S = 4.0
STILL, FLYING = Velocity(), Velocity(SPEED_M_S)


def flown(
    continuity: Continuity,
    east_m: list[float],
    *,
    begin_s: float = 0.0,
    step_s: float = 0.1,
    velocity: Velocity = STILL,
) -> Continuity:
    for index, each_m in enumerate(east_m):
        continuity.take_estimate(Position(each_m, 0.0), time_s=begin_s + index * step_s, velocity=velocity)
    return continuity


def test_a_leg_at_its_speed_has_no_jump() -> None:
    assert flown(Continuity(), [0.4 * number for number in range(200)], velocity=FLYING).doubt_m == 0


def test_a_jump_leaves_doubt_however_long_the_estimate_stays_there() -> None:
    doubted = flown(Continuity(), [0.0] * 10 + [56.0] * 600)
    assert doubted.doubt_m == 56


def test_the_jump_back_ends_the_doubt() -> None:
    assert flown(Continuity(), [0.0] * 10 + [56.0, 56.4, 56.8, 0.8, 1.2]).doubt_m == 0


def test_a_jump_is_longer_than_noise_and_3_m_s_more_than_reported() -> None:
    for step_s, east_m, doubt_m in ((0.1, 3.2, 0.0), (0.1, 3.4, 3.4), (1.0, 6.0, 0.0), (0.0, 56.0, 56.0)):
        assert flown(Continuity(), [0.0, east_m], step_s=step_s).doubt_m == doubt_m


def test_a_jump_counts_in_every_direction_and_is_told_with_its_time() -> None:
    continuity = Continuity()
    for time_s, place in (
        (0.0, Position(0.0, 0.0)),
        (1.0, Position(30.0, 44.0)),
        (2.0, Position(30.0, 48.0)),
    ):
        continuity.take_estimate(place, time_s=time_s, velocity=Velocity(0.0, 4.0))
    assert continuity.doubt_m == 50.0
    assert [(time_s, round(far_m, 2)) for time_s, far_m in continuity.jumps] == [(1.0, 53.25)]


def test_jumps_that_lead_back_to_within_noise_end_the_doubt() -> None:
    assert flown(Continuity(), [0.0, 56.0, 3.0]).doubt_m == 0.0
    assert flown(Continuity(), [0.0, 56.0, 3.5]).doubt_m == 3.5


def test_what_is_accepted_as_true_is_doubted_no_more_and_lets_the_receiver_vouch_again() -> None:
    continuity = flown(Continuity(), [0.0, 56.0])
    for time_s, east_m in ((0.0, 0.0), (0.1, 56.0)):
        continuity.take_receiver(Position(east_m, 0.0), time_s=time_s, velocity=STILL)
    assert continuity.doubt_m == 56.0
    continuity.believe()
    assert continuity.doubt_m == 0.0
    continuity.take_receiver(Position(100.0, 0.0), time_s=20.1, velocity=FLYING)
    flown(continuity, [56.0, 100.0], begin_s=21.0)
    assert continuity.doubt_m == 0.0


def test_a_silence_of_three_seconds_hides_no_flight() -> None:
    assert flown(flown(Continuity(), [0.0]), [60.0], begin_s=3.0, velocity=FLYING).doubt_m == 48.0
    assert flown(flown(Continuity(), [0.0]), [60.0], begin_s=3.5, velocity=FLYING).doubt_m == 60.0


def test_a_silence_allows_for_the_way_flown_meanwhile_and_no_more() -> None:
    assert flown(flown(Continuity(), [0.0]), [60.0], begin_s=15.0, velocity=FLYING).doubt_m == 0
    assert flown(flown(Continuity(), [0.0]), [600.0], begin_s=15.0, velocity=FLYING).doubt_m == 600


def test_a_vehicle_that_comes_to_rest_in_a_silence_may_have_flown_as_before_it() -> None:
    assert flown(flown(Continuity(), [0.0], velocity=FLYING), [60.0], begin_s=10.0).doubt_m == 0
    assert flown(flown(Continuity(), [0.0], velocity=FLYING), [80.0], begin_s=10.0).doubt_m == 80


def test_an_estimate_that_jumps_to_a_receiver_that_never_jumped_is_believed() -> None:
    continuity = flown(Continuity(), [0.0])
    continuity.take_receiver(Position(20.0, 0.0), time_s=0.0, velocity=STILL)
    flown(continuity, [20.0], begin_s=0.1)
    assert continuity.doubt_m == 0


def test_a_receiver_vouches_for_a_place_within_5_m_and_only_if_it_was_heard_before_the_jump() -> None:
    for heard_s, apart_m, doubt_m in ((0.0, 5.0, 0.0), (0.0, 5.5, 20.0), (0.1, 0.0, 20.0)):
        continuity = flown(Continuity(), [0.0])
        continuity.take_receiver(Position(20.0 + apart_m, 0.0), time_s=heard_s, velocity=STILL)
        flown(continuity, [20.0], begin_s=0.1)
        assert continuity.doubt_m == doubt_m


def test_a_receiver_that_was_not_heard_across_the_jump_vouches_for_nothing() -> None:
    continuity = flown(Continuity(), [0.0])
    for time_s, east_m in ((0.0, 0.0), (20.0, 56.0), (21.0, 56.0)):
        continuity.take_receiver(Position(east_m, 0.0), time_s=time_s, velocity=FLYING)
    flown(continuity, [0.0, 56.0, 56.0], begin_s=19.0)
    continuity.take_receiver(Position(56.0, 0.0), time_s=22.0, velocity=FLYING)
    assert continuity.doubt_m == 56


def test_an_estimate_that_follows_a_receiver_that_jumped_is_not() -> None:
    continuity = flown(Continuity(), [0.0])
    for second, east_m in enumerate((0.0, 0.0, 56.0, 56.0)):
        continuity.take_receiver(Position(east_m, 0.0), time_s=float(second), velocity=STILL)
    flown(continuity, [0.0, 56.0, 56.0], begin_s=4.0)
    assert continuity.doubt_m == 56


def test_what_it_flew_while_its_receiver_jumped_is_no_part_of_the_jump() -> None:
    continuity, true_m = Continuity(), 0.0
    for second in range(40):
        off_m = 56.0 if 5 <= second < 20 else 0.0
        continuity.take_receiver(Position(true_m + off_m, 0.0), time_s=float(second), velocity=FLYING)
        filtered_m = true_m + (50.0 if 12 <= second < 27 else 0.0)  # it believes late, and not all
        continuity.take_estimate(Position(filtered_m, 0.0), time_s=second + 0.5, velocity=FLYING)
        true_m += SPEED_M_S
        assert (continuity.doubt_m > 0) == (12 <= second < 27)


def test_a_clock_that_goes_back_begins_anew() -> None:
    assert flown(flown(Continuity(), [0.0], begin_s=100.0), [90.0], begin_s=2.0).doubt_m == 0


@given(st.lists(st.floats(-0.5, 0.5), min_size=2, max_size=200), st.floats(0.05, 2.0))
def test_no_motion_at_the_reported_speed_is_a_jump(changes: list[float], step_s: float) -> None:
    places, here_m = [], 0.0
    for change in changes:
        here_m += 2 * change * SPEED_M_S * step_s
        places.append(here_m)
    assert flown(Continuity(), places, step_s=step_s, velocity=FLYING).doubt_m == 0
