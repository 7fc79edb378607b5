"""The vehicle of profile "px4" flies a leg in the time of a recorded one, and its phases join."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.scenarios import scenario

from upwash.core.geo import Position, Velocity, distance_m
from upwash.lab.run import simulate
from upwash.sim.vehicle import Manner
from upwash.vehicle.body.kinematics import Phase, duration_s
from upwash.vehicle.px4 import airframe

MANNER: Manner = airframe
PROFILED: dict[str, Any] = {"policy": {"name": "local-only"}, "vehicle": {"profile": "px4"}}


def joined(phases: tuple[Phase, ...], end: Position) -> None:
    for before, after in pairwise(phases):
        assert distance_m(before.end, after.start) < 1e-6
    assert distance_m(phases[-1].end, end) < 0.1


@pytest.mark.parametrize(("speed_m_s", "took_s"), [(4.0, 14.79), (8.0, 11.68)])
def test_a_leg_of_40_m_takes_as_long_as_recorded(speed_m_s: float, took_s: float) -> None:
    leg = airframe.waypoint_leg(Position(0, 0, 10), Position(40, 0, 10), ground_speed_m_s=speed_m_s)
    assert airframe.arrival_s(leg) == pytest.approx(took_s, rel=0.05)
    assert 0.5 < max(phase.end.east_m for phase in leg) - 40 < 1.6  # it overshoots


@pytest.mark.parametrize(("away_m", "took_s"), [(144.0, 77.95), (80.0, 62.89)])
def test_a_return_from_10_m_takes_as_long_as_recorded(away_m: float, took_s: float) -> None:
    home = airframe.return_and_land(Position(away_m, 0, 10), Position(0, 0))
    assert duration_s(home) == pytest.approx(took_s, rel=0.05)


@given(st.floats(-200, 200), st.floats(-200, 200), st.floats(1, 60), st.floats(0.5, 15))
def test_phases_join_and_lead_where_they_should(
    east_m: float, north_m: float, altitude_m: float, cap_m_s: float
) -> None:
    start, end = Position(0, 0, 20), Position(east_m, north_m, altitude_m)
    if distance_m(start, end) < 1:
        return
    joined(airframe.waypoint_leg(start, end, ground_speed_m_s=cap_m_s), end)
    stop = airframe.brake(start, Velocity(east_m_s=cap_m_s))
    assert all(phase.duration_s > 0 for phase in stop)
    home = airframe.return_and_land(end, Position(0, 0))
    joined(home, Position(0, 0))
    assert duration_s(home) > 0


def test_a_simulated_mission_flies_by_it() -> None:
    events = simulate(scenario(**PROFILED)).events
    assert sum(event.kind == "arrived" for event in events) == 18
