"""The chance of a demand at a place: near answers count, earlier flights count less."""

from __future__ import annotations

import math

import pytest

from upwash.core.geo import MOST_PLACES, Position, Waypoint
from upwash.core.planning.demand_map import DemandMap, DemandPlace, near_m
from upwash.core.planning.stay_or_go import Outlook, RowOutlook, StayRule

HERE = Position(100.0, 50.0, 20.0)
ROW = RowOutlook(4.0, 1.0, 3.0, 1.0)


def known(*places: tuple[float, float, float], near: float = 20.0) -> DemandMap:
    """Places east of HERE: metres, answers, demands."""
    return DemandMap(
        (
            DemandPlace(Position(HERE.east_m + east_m, HERE.north_m), answers, demands)
            for east_m, answers, demands in places
        ),
        near_m=near,
    )


def test_without_answers_around_it_a_place_has_the_chance_of_everywhere() -> None:
    assert known().chance(HERE, 0.25) == 0.25
    assert known((61.0, 50.0, 50.0), (-500.0, 50.0, 50.0)).chance(HERE, 0.25) == pytest.approx(0.25)


def test_answers_count_by_their_distance() -> None:
    assert known((0.0, 4.0, 3.0)).chance(HERE, 0.1) == pytest.approx((3 + 2 * 0.1) / (4 + 2))
    near = math.exp(-0.5)
    assert known((20.0, 4.0, 3.0)).chance(HERE, 0.1) == pytest.approx((3 * near + 0.2) / (4 * near + 2))
    both = known((20.0, 4.0, 3.0), (0.0, 2.0, 0.0)).chance(HERE, 0.1)
    assert both == pytest.approx((3 * near + 0.2) / (4 * near + 2 + 2))


@pytest.mark.parametrize("away_m", [0.0, 13.0, 29.9, -29.9, 45.0, -59.0])
def test_a_place_counts_on_whichever_side_it_lies(away_m: float) -> None:
    weight = math.exp(-((away_m / 20.0) ** 2) / 2)
    assert known((away_m, 5.0, 5.0)).chance(HERE, 0.2) == pytest.approx((5 * weight + 0.4) / (5 * weight + 2))


def test_answers_of_one_place_are_counted_together() -> None:
    demands = known()
    for east_m, demanded in ((0.0, True), (1.5, False), (2.5, True)):
        demands.note(Position(HERE.east_m + east_m, HERE.north_m, 20.0), demanded=demanded)
    assert [(place.answers, place.demands) for place in demands.places()] == [(2.0, 1.0), (1.0, 1.0)]


def test_a_flight_later_an_answer_counts_half() -> None:
    place = DemandPlace(HERE, 4.0, 3.0).faded()
    assert (place.answers, place.demands, place.flights_ago) == (2.0, 1.5, 1)
    demands = DemandMap([place], near_m=20.0)
    demands.note(HERE, demanded=True)
    (now,) = demands.places()
    assert (now.answers, now.demands, now.flights_ago) == (3.0, 2.5, 0)


def test_a_map_is_bounded_and_the_longest_known_makes_room() -> None:
    demands = known(near=10.0)
    for number in range(MOST_PLACES + 10):
        demands.note(Position(3.0 * number, 0.0), demanded=False)
    places = [place.position.east_m for place in demands.places()]
    assert len(places) == MOST_PLACES
    assert (min(places), max(places)) == (30.0, 3.0 * (MOST_PLACES + 9))


def test_near_is_a_step_of_the_plan_and_at_least_ten_metres() -> None:
    line = [Waypoint(number, Position(30.0 * number, 0.0)) for number in range(5)]
    assert near_m(line) == 30.0
    assert near_m([Waypoint(number, Position(2.0 * number, 0.0)) for number in range(5)]) == 10.0
    assert near_m(line[:1]) == near_m([]) == 10.0


def test_an_empty_map_says_of_the_flight_what_no_map_says() -> None:
    plain, mapped = StayRule("learn"), StayRule("learn", known())
    for demanded in (True, False, False, True):
        for rule in (plain, mapped):
            rule.answered(1.0, demanded=demanded, place=None)
        assert plain.chance == mapped.chance
        assert plain.decide(ROW) == mapped.decide(ROW) == mapped.decide(ROW, HERE)


@pytest.mark.parametrize(("demands", "goes"), [(0.0, True), (20.0, False)])
def test_the_drone_goes_or_stays_by_the_place(demands: float, goes: bool) -> None:
    rule = StayRule("learn", known((0.0, 20.0, demands), (400.0, 20.0, 20.0 - demands)))
    outlook: Outlook | RowOutlook = ROW
    verdict = rule.decide(outlook, HERE)
    assert verdict.goes == goes
    assert verdict.chance == pytest.approx((demands + 2 * 21 / 44) / 22)
    other = rule.decide(outlook, Position(500.0, 50.0))
    assert other.goes != goes
