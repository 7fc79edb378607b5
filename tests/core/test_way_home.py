"""How much longer a return takes: it counts down to the ground, for both firmwares' own returns."""

from __future__ import annotations

import itertools

import pytest

from upwash.core.geo import Position
from upwash.core.vehicle.way_home import ARDUCOPTER, PX4, WayDown, WayHome, time_home_s
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.kinematics import Motion
from upwash.vehicle.px4 import airframe as px4

HOME = Position(0.0, 0.0)
PLACES = [
    Position(40.0, 0.0, 15.0),
    Position(0.5, 0.0, 4.0),
    Position(150.0, -90.0, 45.0),
    Position(10.0, 0.0, 12.0),
]


def told(way: WayHome, motion: Motion, home: Position | None) -> list[tuple[float, float]]:  # type: ignore[type-arg]
    """What is said each second, with what is really left."""
    down = WayDown(way, motion.position(0.0), home)
    return [
        (down.left_s(motion.position(float(now_s)), now_s=float(now_s)), motion.ends_s - now_s)
        for now_s in range(int(motion.ends_s) + 1)
    ]


@pytest.mark.parametrize("start", PLACES)
@pytest.mark.parametrize(("way", "airframe"), [(ARDUCOPTER, arducopter), (PX4, px4)])
def test_the_time_that_is_left_counts_down(way: WayHome, airframe: object, start: Position) -> None:
    phases = airframe.return_and_land(start, HOME)  # type: ignore[attr-defined]
    said = told(way, Motion(0.0, phases, phases[-1].end), HOME)
    assert said[0][0] == pytest.approx(time_home_s(start, HOME, way))
    for (before_s, _), (after_s, _) in itertools.pairwise(said):
        assert after_s <= before_s + 0.3
    for left_s, really_s in said:
        assert left_s <= 1.35 * really_s + 8.0
    near_the_end = [left_s for left_s, really_s in said if really_s <= 8.0]
    assert max(near_the_end) <= 10.0, "8 s before touchdown it does not say 43"


@pytest.mark.parametrize(("way", "airframe"), [(ARDUCOPTER, arducopter), (PX4, px4)])
def test_a_landing_where_it_is_counts_down_at_once(way: WayHome, airframe: object) -> None:
    phases = airframe.landing(Position(30.0, 30.0, 20.0))  # type: ignore[attr-defined]
    said = told(way, Motion(0.0, phases, phases[-1].end), None)
    for left_s, really_s in said:
        assert left_s == pytest.approx(really_s, abs=8.0)


PLAIN = WayHome(
    altitude_m=30.0, climb_m_s=2.0, speed_m_s=10.0, acceleration_m_s2=1.0, hover_s=5.0, descent_m_s=2.0,
    slowly_below_m=10.0, landing_m_s=0.5,
)  # fmt: skip
CLIMB_S, WAY_S, DOWN_S, SINKING_S = 20 / 2 + 2, 400 / 10 + 10, 20 / 2 + 2 + 20.0, 20 / 2 + 20.0


@pytest.mark.parametrize(
    ("reports", "left_s"),
    [
        ([(400, 10)], CLIMB_S + WAY_S + 5.0 + DOWN_S),
        ([(400, 20)], 7.0 + WAY_S + 5.0 + DOWN_S),
        ([(400, 30)], WAY_S + 5.0 + DOWN_S),
        ([(398, 10)], CLIMB_S + WAY_S - 2.0 + 5.0 + DOWN_S),
        ([(397, 10)], WAY_S - 6.0**0.5 + 5.0 + DOWN_S),  # it climbs the rest on its way
        ([(410, 30)], WAY_S + 1.0 + 5.0 + DOWN_S),  # it still flies away
        ([(350, 30)], WAY_S - 10.0 + 5.0 + DOWN_S),
        ([(2.5, 30)], 5.0**0.5 + 5.0 + DOWN_S),
        ([(2, 30)], 5.0 + SINKING_S),
        ([(0, 29)], 5.0 + 19 / 2 + 20.0),
        ([(0, 28.5)], 5.0 + DOWN_S),  # it has not climbed yet
        ([(0, 30)] * 4, 2.0 + SINKING_S),
        ([(0, 30)] * 9, SINKING_S),
        ([(0, 30), (0, 29)], 4.0 + SINKING_S),
        ([(0, 30), (0, 28)], 18 / 2 + 20.0),
        ([(0, 30), (0, 4)], 0.6 * 8.0),  # no more than three times as fast is believed
        ([(0, 30), (0, -1)], 0.0),
    ],
)
def test_each_part_of_a_return_is_left_until_the_next_has_begun(
    reports: list[tuple[float, float]], left_s: float
) -> None:
    down = WayDown(PLAIN, Position(400.0, 0.0, 10.0), HOME)
    for second, (east_m, altitude_m) in enumerate(reports):
        said_s = down.left_s(Position(east_m, 0.0, altitude_m), now_s=100.0 + second)
    assert said_s == pytest.approx(left_s)


def test_a_return_from_above_needs_no_climb_and_a_landing_needs_no_way() -> None:
    above = Position(400.0, 0.0, 50.0)
    assert WayDown(PLAIN, above, HOME).left_s(above, now_s=0.0) == WAY_S + 5.0 + 40 / 2 + 2 + 20.0
    drifted = Position(410.0, 0.0, 50.0)
    assert WayDown(PLAIN, above, None).left_s(drifted, now_s=0.0) == 40 / 2 + 20.0


def test_a_vehicle_that_sinks_without_having_climbed_is_believed() -> None:
    down = WayDown(PX4, Position(1.0, 0.0, 12.0), HOME)
    assert down.left_s(Position(1.0, 0.0, 12.0), now_s=0.0) > 40.0
    assert down.left_s(Position(1.0, 0.0, 5.0), now_s=6.0) == 10.0


@pytest.mark.parametrize("pace", [0.5, 1.0, 2.0])
def test_the_rest_of_a_descent_takes_as_long_as_the_vehicle_shows(pace: float) -> None:
    """It sinks steadily on each part, in so many times the expected time."""
    down = WayDown(PLAIN, Position(0.0, 0.0, 30.0), HOME)
    fast_s, slow_s = pace * 20 / 2, pace * 10 / 0.5
    for now_s in range(int(fast_s + slow_s)):
        fast_m, slow_m = 20 * min(1.0, now_s / fast_s), 10 * max(0.0, now_s - fast_s) / slow_s
        said_s = down.left_s(Position(0.0, 0.0, 30.0 - fast_m - slow_m), now_s=float(now_s))
    assert said_s == pytest.approx(1.0, abs=0.2)
