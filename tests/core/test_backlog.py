"""Where a resting drone waits best for a line of photos."""

from __future__ import annotations

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.backlog import Backlog
from upwash.core.planning.legs import Pace

HERE, HOME = Position(100.0, 0.0, 20.0), Position(0.0, 0.0)


def backlog(
    photos: int = 20, *, range_m: float = 50.0, check_s: float = 5.0, after: Position | None = HOME
) -> Backlog:
    """At 5 m/s and 10 s a photo on the drone, 1 s on a server 100 m beside the drone, 55 m from its inside."""
    server = ServerBelief(Circle(Position(100.0, 100.0), range_m), 1.0, check_s, check_s)
    return Backlog(
        photos=photos,
        local_s=10.0,
        servers={"s1": server},
        gain_switch=0.25,
        ground_speed_m_s=5.0,
        pace=Pace(acceleration_m_s2=2.5),
        after=after,
    )


def anywhere(_: Position) -> bool:
    return True


def test_here_the_drone_answers_all_and_flies_home() -> None:
    assert backlog().ends_s(HERE, HERE) == pytest.approx(200.0 + 22.0)
    assert backlog(after=None).ends_s(HERE, HERE) == pytest.approx(200.0)


def test_on_the_way_and_in_the_range_both_places_answer() -> None:
    """The way of 55 m takes 13 s, the border is passed after 10 + 1 s, and the check lasts until 16 s."""
    there = Position(100.0, 55.0, 20.0)
    answered_s = backlog(after=None).ends_s(HERE, there)
    assert 13.0 + 17.0 <= answered_s <= 17.0 + 18.0
    assert backlog().ends_s(HERE, there) == pytest.approx(answered_s + backlog().onwards_s(there))


def test_the_best_place_is_in_a_range_only_where_that_ends_the_line_sooner() -> None:
    name, place = backlog().best(HERE, anywhere) or ("", HERE)
    assert name == "s1" and place.north_m == pytest.approx(55.0, abs=15.0)
    assert backlog(photos=2).best(HERE, anywhere) is None, "the drone is through before it is there"
    assert backlog().best(HERE, lambda _: False) is None, "a fence forbids the way"
    assert backlog(check_s=500.0).best(HERE, anywhere) is None
    assert backlog(range_m=200.0).best(HERE, anywhere) is None, "it is in the range"
