"""Where an act costs least, against times computed by hand and against the flown way."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Position, Waypoint, distance_m
from upwash.core.planning.acts import Acts, WayAhead, cheapest
from upwash.core.planning.legs import Leg, Pace

# Two rows of 80 m, 10 m apart, with a spot each 20 m: 0 to 4 eastwards and 5 to 9 back. 4 m/s and 1 m/s²: a leg of
# more than 16 m takes its length / 4 s, and 4 s.
FIRST = [Position(20.0 * number, 0.0) for number in range(5)]
SECOND = [Position(80.0 - 20.0 * number, 10.0) for number in range(5)]
SPOTS = [*FIRST, *SECOND]
PLAN = [Waypoint(n, spot, row_end=(FIRST if n < 5 else SECOND)[-1]) for n, spot in enumerate(SPOTS)]
STOPS = [Waypoint(number, spot) for number, spot in enumerate(SPOTS)]


def acts(plan: list[Waypoint] = PLAN, **known: Any) -> Acts[str]:
    facts: dict[str, Any] = {"photo_s": 1.0, "home_s": lambda _: 16.0}
    return Acts(plan, ground_speed_m_s=4.0, pace=Pace(1.0), **facts | known)


def put_off(
    late: Acts[str], act: str, place: Position, way: WayAhead, **limits: Any
) -> tuple[float, float] | None:
    """What the act costs where it is put off to, and at once; None where it is not put off."""
    choice = late.choice(place, way, **limits)
    if (chosen := cheapest(choice)) is None:
        return None
    late.put_off(act, place, choice.gaps[chosen])
    return choice.gaps[chosen].extra_s, choice.at_once_s


def on_leg(east_m: float, target: int) -> WayAhead:
    """On the first row, at its speed: the drone would rest 8 m further."""
    here = Position(east_m, 0.0)
    return WayAhead(here, target, here, FIRST[-1], Position(east_m + 8.0, 0.0))


def leg_s(start: Position, end: Position) -> float:
    return Leg(distance_m(start, end), 4.0, 1.0).duration_s


def test_an_act_that_is_passed_on_the_way_home_costs_least_there() -> None:
    late = acts(home_s=lambda place: leg_s(place, SPOTS[0]))
    # At once: 4 s to rest at 40 m, 9 s back to the spot, 60 m on in 19 s; the way from 32 m on takes 14 s.
    found = put_off(late, "act", SPOTS[1], on_leg(32.0, 2))
    assert found is not None
    assert found[1] == pytest.approx(4.0 + leg_s(Position(40.0, 0.0), SPOTS[1]) + 19.0 - (48.0 / 4 + 2.0))
    # Within the second row, at 20 m: it rests there for the photo, and goes on from the act to the last spot.
    assert found[0] == pytest.approx(
        leg_s(SECOND[0], SECOND[3])
        + 1.0
        + leg_s(SECOND[3], SPOTS[1])
        + leg_s(SPOTS[1], SECOND[4])
        - leg_s(SECOND[0], SECOND[4])
    )
    assert late.waits_after(8) and not late.waits_after(9)
    assert late.due_after(8) == ["act"] and late.due_after(8) == []


def test_an_act_is_not_put_off_where_that_costs_more_or_may_not_be() -> None:
    far = acts(PLAN[:5], home_s=lambda place: 16.0 + distance_m(place, SPOTS[4]))
    assert put_off(far, "act", SPOTS[3], on_leg(66.0, 4)) is None, "the way home begins beyond"
    assert put_off(acts(), "act", SPOTS[1], on_leg(32.0, 2), within_s=5.0) is None
    assert put_off(acts(), "act", SPOTS[1], on_leg(32.0, 2), allows=lambda *_: False) is None


def test_on_a_leg_beyond_the_last_spot_of_a_row_no_spot_of_it_is_rested_at() -> None:
    beyond = [Position(84.0, 0.0), Position(-4.0, 10.0)]
    plan = [Waypoint(n, spot, row_end=beyond[n > 4]) for n, spot in enumerate(SPOTS)]
    way = WayAhead(Position(32.0, 0.0), 2, Position(32.0, 0.0), beyond[0], Position(40.0, 0.0))
    assert acts(plan).choice(SPOTS[1], way).gaps[0].number >= 4


def test_acts_at_one_place_share_the_way_there() -> None:
    late = acts(STOPS)
    way = WayAhead(SPOTS[4], 5, SPOTS[5])
    beside = Position(SPOTS[8].east_m, SPOTS[8].north_m + 30.0)
    first = put_off(late, "first", beside, way)
    second = put_off(late, "second", Position(beside.east_m + 1.0, beside.north_m), way)
    assert first is not None and second is not None
    assert second[0] < 0.2 * first[0]
    assert sorted(late.all()) == ["first", "second"]


def test_an_act_that_was_put_off_is_taken_where_it_costs_no_more_now() -> None:
    late = acts(STOPS)
    assert put_off(late, "act", SPOTS[8], WayAhead(SPOTS[4], 5, SPOTS[5])) is not None
    there = WayAhead(SPOTS[8], 9, SPOTS[9])
    assert late.take(there, lambda _, choice: cheapest(choice) is None) == ["act"]
    assert late.all() == []


# None is on the straight way from another to a spot.
POINTS = st.builds(Position, st.integers(-99, 199), st.integers(-99, 199).map(lambda north_m: north_m + 0.37))


@given(places=st.lists(POINTS, min_size=1, max_size=5, unique=True), plan=st.sampled_from([PLAN, STOPS]))
def test_the_costs_of_all_acts_are_what_the_whole_way_takes_longer(
    places: list[Position], plan: list[Waypoint]
) -> None:
    late = acts(plan, home_s=lambda place: leg_s(place, SPOTS[0]))
    far = WayAhead(away := Position(0.0, -1e4), 0, away)  # at once costs more than in each gap
    found = [put_off(late, str(number), place, far) for number, place in enumerate(places)]
    extra_s = [costs[0] for costs in found if costs is not None]
    assert len(extra_s) == len(places)
    gaps = [[places[int(act)] for act in late.due_after(number)] for number in range(len(plan))]
    assert sum(extra_s) == pytest.approx(way_s(plan, gaps) - way_s(plan, [[] for _ in plan]), abs=1e-6)


def way_s(plan: list[Waypoint], gaps: list[list[Position]]) -> float:
    """The time from the first spot over the acts home; a photo of a spot that is not passed takes a second."""
    rests, photos_s = [], 0.0
    for number, spot in enumerate(SPOTS):
        ends = plan is STOPS or number in (0, 4, 5, 9)
        if ends or gaps[number] or gaps[number - 1]:
            rests.append(spot)
        photos_s += bool(gaps[number]) and (plan is PLAN and number not in (4, 9))
        rests += gaps[number]
    return photos_s + sum(itertools.starmap(leg_s, itertools.pairwise([*rests, SPOTS[0]])))
