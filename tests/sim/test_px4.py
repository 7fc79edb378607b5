"""The vehicle of profile "px4" flies rows and holds in the times of flown ones, and its phases join."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.scenarios import scenario

from upwash.core.geo import Position, Velocity, distance_m
from upwash.lab.run import simulate
from upwash.sim.vehicle import FlightModel
from upwash.vehicle.body.kinematics import Phase, duration_s
from upwash.vehicle.px4 import airframe

MANNER: FlightModel = airframe
PROFILED: dict[str, Any] = {"policy": {"name": "local-only"}, "vehicle": {"profile": "px4"}}


def joined(phases: tuple[Phase, ...], end: Position) -> None:
    for before, after in pairwise(phases):
        assert distance_m(before.end, after.start) < 1e-6
    assert distance_m(phases[-1].end, end) < 0.001, "or a simulated drone flies there again"


def passed_s(phases: tuple[Phase, ...], way_m: float) -> float:
    """The second in which it passes that place east of its start."""
    elapsed_s = 0.0
    for phase in phases:
        if phase.end.east_m >= way_m:
            share = (way_m - phase.start.east_m) / (phase.end.east_m - phase.start.east_m)
            return elapsed_s + share * phase.duration_s
        elapsed_s += phase.duration_s
    raise AssertionError(way_m)


@pytest.mark.parametrize(
    ("speed_m_s", "passes_s", "arrives_s", "hold_s"),
    [(4.0, (6.9, 11.9, 16.9, 23.0), 25.9, 4.0), (8.0, (6.2, 8.7, 11.2, 15.5), 20.9, 7.0)],
)
def test_a_row_is_flown_as_upwash_flew_a_real_one(
    speed_m_s: float, passes_s: tuple[float, ...], arrives_s: float, hold_s: float
) -> None:
    row = airframe.waypoint_leg(Position(0, 0, 10), Position(80, 0, 10), ground_speed_m_s=speed_m_s)
    spots_m = (20.0, 40.0, 60.0, 80.0)
    assert [passed_s(row, way_m) for way_m in spots_m] == pytest.approx(passes_s, abs=0.6)
    assert airframe.arrival_s(row) == pytest.approx(arrives_s, rel=0.06)
    assert 0.5 < max(phase.end.east_m for phase in row) - 80 < 2.0  # it overshoots
    held = airframe.hold(Position(0, 0, 10), Velocity(east_m_s=speed_m_s))
    assert airframe.arrival_s(held) == pytest.approx(hold_s, rel=0.1)


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
