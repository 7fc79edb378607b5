from __future__ import annotations

import pytest

from upwash.core.geo import Position
from upwash.core.knowledge.coverage import MOST_PLACES, NEAR_M, SAME_M, Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation

HEAVY = Operation("detector", "process_photo", "heavy")
LIGHT = Operation("detector", "process_photo", "light")
HERE = Position(100.0, 0.0)
LOCAL_S, REMOTE_S = 10.0, 1.0


def coverage() -> Coverage:
    return Coverage({"lte": ()})


def estimates(known: Coverage) -> Estimates:
    """Heavy and light calls, as slow on the drone as each other, and fast on the servers lte and s1."""
    beliefs = Beliefs(3.0, 1.0, {HEAVY: REMOTE_S, LIGHT: REMOTE_S})
    return Estimates(
        local_s={HEAVY: LOCAL_S, LIGHT: LOCAL_S}, servers={"lte": beliefs, "s1": beliefs}, coverage=known
    )


def east_of_here(by_m: float) -> Position:
    return Position(HERE.east_m + by_m, HERE.north_m, 30.0)


def test_what_is_measured_at_a_place_is_believed_around_it() -> None:
    known = coverage()
    place = known.asked("lte", HERE, answered=True)
    assert known.at("lte", east_of_here(NEAR_M)) is place
    assert known.at("lte", east_of_here(-NEAR_M)) is place
    assert known.at("lte", east_of_here(NEAR_M + 0.1)) is None
    for east_m, north_m in ((0.0, NEAR_M), (0.0, -NEAR_M), (8.0, -8.0), (-8.0, 8.0)):
        assert known.at("lte", Position(HERE.east_m + east_m, north_m)) is place
        assert known.at("lte", Position(HERE.east_m + 1.1 * east_m, 1.1 * north_m)) is None
    assert known.at("s1", HERE) is None


def test_the_nearest_place_counts() -> None:
    known = coverage()
    first = known.asked("lte", HERE, answered=True)
    second = known.asked("lte", east_of_here(SAME_M + 1.0), answered=False)
    assert known.at("lte", east_of_here(4.0)) is first
    assert known.at("lte", east_of_here(5.0)) is second
    assert known.asked("lte", east_of_here(1.0), answered=True) is first
    assert (first.tried, first.answered, second.tried, second.answered) == (2, 2, 1, 0)


def test_a_place_is_the_same_within_8_m_and_its_latest_call_is_new() -> None:
    known = coverage()
    first = known.asked("lte", HERE, answered=True)
    first.flights_ago = 5
    assert known.asked("lte", east_of_here(SAME_M), answered=False) is first
    assert first.flights_ago == 0
    assert known.asked("lte", east_of_here(SAME_M + 0.5), answered=False) is not first


def test_a_call_comes_to_the_mean_of_the_last_three_there() -> None:
    known = coverage()
    place = known.asked("lte", HERE, answered=True)
    for came_to_s in (9.0, 1.0, 2.0, 3.0):
        place.note(HEAVY, came_to_s)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY, HERE) == pytest.approx(2.0)
    assert believed.remote_s("lte", HEAVY, east_of_here(50.0)) == REMOTE_S
    assert believed.remote_s("s1", HEAVY, HERE) == REMOTE_S


def test_where_a_server_does_not_answer_a_call_is_no_faster_than_on_the_drone() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=False)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY, HERE) == LOCAL_S
    assert believed.mean_call_s("lte", HERE) == believed.mean_call_s()
    assert believed.mean_call_s("lte", east_of_here(50.0)) == REMOTE_S


def test_an_answered_check_says_that_the_server_is_there_and_nothing_of_its_delay() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=True)
    assert estimates(known).remote_s("lte", HEAVY, HERE) == REMOTE_S


def test_where_no_place_is_named_that_of_the_drone_counts() -> None:
    known = coverage()
    known.asked("lte", HERE, answered=False)
    believed = estimates(known)
    assert believed.remote_s("lte", HEAVY) == REMOTE_S
    assert believed.locate(HERE)
    assert believed.remote_s("lte", HEAVY) == LOCAL_S
    assert not believed.locate(east_of_here(1.0))
    assert believed.locate(east_of_here(50.0))


def test_goodput_is_told_by_calls_that_carry_something() -> None:
    place = coverage().asked("lte", HERE, answered=True)
    place.carry(100, 0.5)
    assert place.goodput_bit_s is None
    place.carry(500_000, 0.5)
    place.carry(500_000, 1.5)
    assert place.goodput_bit_s == pytest.approx(4e6)


def test_the_places_of_a_server_are_bounded() -> None:
    known = coverage()
    for number in range(MOST_PLACES + 10):
        known.asked("lte", Position(0.0, 10.0 * number), answered=True)
    assert len(list(known.places("lte"))) == MOST_PLACES
    assert known.at("lte", Position(0.0, 10.0 * (MOST_PLACES + 9))) is not None
    assert known.at("lte", Position(0.0, -10.0)) is None


@pytest.mark.parametrize(
    ("answered", "tried", "reached"), [(0, 0, True), (1, 1, True), (1, 2, True), (1, 3, False), (0, 1, False)]
)
def test_a_place_is_reached_where_half_of_the_calls_are_answered(
    answered: int, tried: int, *, reached: bool
) -> None:
    assert MeasuredPlace(HERE, tried, answered).reached is reached


def test_the_goodput_of_a_place_is_that_of_large_calls() -> None:
    place = MeasuredPlace(HERE)
    place.carry(9_999, 1.0)
    assert place.goodput_bit_s is None
    place.carry(10_000, 2.0)
    place.carry(30_000, 3.0)
    assert place.goodput_bit_s == 8 * 40_000 / 5.0
