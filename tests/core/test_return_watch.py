"""Whether a return lands, by the vehicle's reports."""

from __future__ import annotations

import pytest

from upwash.core.geo import Position
from upwash.core.vehicle.return_place import ReturnPlace
from upwash.core.vehicle.return_watch import ReturnWatch
from upwash.core.vehicle.way_home import ARDUCOPTER, HOVER_SEEN_S

HOME = ReturnPlace("home", Position(0.0, 0.0))
CLIMBED_S, RESTS_S = 2.0, 8.0  # of a return that begins above home


def altitude_m(now_s: float) -> float:
    """It climbs from 10 to 15 m, rests there, and sinks to the ground, slowly on the last 10 m."""
    if now_s < CLIMBED_S + RESTS_S:
        return min(15.0, 10.0 + 2.5 * now_s)
    sinks_s = now_s - CLIMBED_S - RESTS_S
    return max(0.0, 15.0 - 1.5 * sinks_s if sinks_s < 5 / 1.5 else 10.0 - 0.5 * (sinks_s - 5 / 1.5))


@pytest.mark.parametrize("late_s", [0.1 * tenths for tenths in range(10)])
def test_a_return_that_climbs_rests_and_sinks_never_hovers(late_s: float) -> None:
    watch = ReturnWatch(ARDUCOPTER, HOME, Position(0.0, 0.0, altitude_m(0.0)), now_s=0.0, known=True)
    for second in range(40):  # it is looked at each second
        now_s = second + late_s
        watch.take(Position(0.0, 0.0, altitude_m(now_s)), now_s)
        assert not watch.hovers, f"{altitude_m(now_s):.1f} m at {now_s:.1f} s"


def test_a_rest_on_the_way_down_is_a_hover() -> None:
    watch = ReturnWatch(ARDUCOPTER, HOME, Position(0.0, 0.0, altitude_m(0.0)), now_s=0.0, known=True)
    for second in range(12):
        watch.take(Position(0.0, 0.0, altitude_m(second)), second)
    stays = Position(0.0, 0.0, altitude_m(11))
    watch.take(stays, 9 + HOVER_SEEN_S)
    assert not watch.hovers
    watch.take(stays, 11 + HOVER_SEEN_S)
    assert watch.hovers
