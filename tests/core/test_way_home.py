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


def test_a_vehicle_that_sinks_without_having_climbed_is_believed() -> None:
    down = WayDown(PX4, Position(1.0, 0.0, 12.0), HOME)
    assert down.left_s(Position(1.0, 0.0, 12.0), now_s=0.0) > 40.0
    assert down.left_s(Position(1.0, 0.0, 5.0), now_s=6.0) == 10.0
