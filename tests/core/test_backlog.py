"""Where a resting drone waits best for a line of photos."""

from __future__ import annotations

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.planning.backlog import Backlog, ServerBelief, Stay, WaitPlace, soonest
from upwash.core.planning.legs import Pace

HERE, HOME = Position(100.0, 0.0, 20.0), Position(0.0, 0.0)


def backlog(
    photos: int = 20, *, range_m: float = 50.0, check_s: float = 5.0, after: Position | None = HOME
) -> Backlog:
    """At 5 m/s and 10 s a photo on the drone, 1 s on a server 100 m beside the drone, 55 m from its inside."""
    server = ServerBelief(Circle(Position(100.0, 100.0), range_m), 1.0, check_s)
    return Backlog(
        photos=photos,
        local_s=10.0,
        servers={"s1": server},
        gain_switch=0.25,
        ground_speed_m_s=5.0,
        pace=Pace(acceleration_m_s2=2.5),
        after=after,
    )


def stay(backlog: Backlog, *, passes_range: bool = False) -> Stay:
    here = backlog.wait_at(HERE, here=HERE)
    return Stay(backlog.photos, [here, *backlog.ranges(HERE)], passes_range)


def there(backlog: Backlog) -> WaitPlace:
    (place,) = backlog.ranges(HERE)
    return place


def test_here_the_drone_answers_all_and_flies_home() -> None:
    here = backlog().wait_at(HERE, here=HERE)
    assert (here.answered_s, here.ends_s) == pytest.approx((200.0, 200.0 + 22.0))
    assert (here.server, here.extra_s) == (None, 0.0)
    assert backlog(after=None).wait_at(HERE, here=HERE).ends_s == pytest.approx(200.0)


def test_on_the_way_and_in_the_range_both_places_answer() -> None:
    """The way of 55 m takes 13 s, the border is passed after 10 + 1 s, and the check lasts until 16 s."""
    place = Position(100.0, 55.0, 20.0)
    answered_s = backlog(after=None).wait_at(place, here=HERE).ends_s
    assert 13.0 + 17.0 <= answered_s <= 17.0 + 18.0
    there = backlog().wait_at(place, here=HERE)
    assert (there.answered_s, there.ends_s) == pytest.approx(
        (answered_s, answered_s + backlog().onwards_s(place))
    )
    assert there.extra_s == pytest.approx((55.0 + (100.0**2 + 55.0**2) ** 0.5 - 100.0) / 5.0)


def test_the_best_place_is_in_a_range_only_where_that_ends_the_line_sooner() -> None:
    assert soonest(stay(backlog())) == "s1"
    assert there(backlog()).position.north_m == pytest.approx(55.0, abs=15.0)
    assert soonest(stay(backlog(photos=2))) is None, "the drone is through before it is there"
    assert soonest(stay(backlog(check_s=500.0))) is None
    assert soonest(stay(backlog(), passes_range=True)) is None
    assert list(backlog(range_m=200.0).ranges(HERE)) == [], "it is in the range"
