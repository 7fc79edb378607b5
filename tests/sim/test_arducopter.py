"""The vehicle of profile "arducopter" against recorded flights of a real one."""

from __future__ import annotations

import asyncio
import csv
import itertools
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.scenarios import HEAVY_S, scenario

from upwash.core.geo import Position, distance_m
from upwash.lab.run import simulate
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.kinematics import Motion, duration_s

ALTITUDE_M = 15.0
HOVER_S = 3.0
TAKEOFF_S = 12.6  # from arming, 0.4 s before the command
RETURN_AND_LAND_S = 44.0  # from 59.8 m away
SAMPLE_S = 0.2
PROFILED: dict[str, Any] = {"policy": {"name": "local-only"}, "vehicle": {"profile": "arducopter"}}
RECORDED = list(
    csv.DictReader(
        (Path(__file__).parent / "data/arducopter_legs.csv").read_text(encoding="utf-8").splitlines()
    )
)


def target(leg: dict[str, str]) -> Position:
    return Position(float(leg["to_east_m"]), float(leg["to_north_m"]), ALTITUDE_M)


async def fly_the_recorded_mission() -> tuple[list[float], dict[str, float]]:
    """The time of each leg, and of the mission's stages."""
    clock = asyncio.get_running_loop().time
    autopilot = ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=4.0, manner=arducopter)
    await autopilot.claim(resumes=False)
    await autopilot.arm()
    await autopilot.takeoff(ALTITUDE_M)
    took_off_s = clock()
    legs_s = []
    await asyncio.sleep(HOVER_S)
    for leg in RECORDED:
        begun_s = clock()
        await autopilot.goto(target(leg))
        legs_s.append(clock() - begun_s)
        await asyncio.sleep(HOVER_S)
    flown_s = clock()
    await autopilot.return_home_and_land()
    await autopilot.disarm()
    return legs_s, {
        "take-off": took_off_s,
        "grid": flown_s - took_off_s,
        "return": clock() - flown_s,
        "all": clock(),
    }


def test_every_leg_and_the_whole_mission_take_as_long_as_recorded() -> None:
    legs_s, stages_s = run_virtually(fly_the_recorded_mission())
    for leg_s, leg in zip(legs_s, RECORDED, strict=True):
        assert leg_s == pytest.approx(float(leg["arrival_s"]) - float(leg["begin_s"]), rel=0.03)
    grid_s = float(RECORDED[-1]["arrival_s"]) + HOVER_S
    assert stages_s["grid"] == pytest.approx(grid_s, rel=0.02)
    assert stages_s["take-off"] == pytest.approx(TAKEOFF_S, rel=0.02)
    assert stages_s["return"] == pytest.approx(RETURN_AND_LAND_S, rel=0.02)
    assert stages_s["all"] == pytest.approx(TAKEOFF_S + grid_s + RETURN_AND_LAND_S, rel=0.02)


@pytest.mark.parametrize(
    "leg", [leg for leg in RECORDED if leg["speeds_m_s"]], ids=lambda leg: str(leg["leg"])
)
def test_the_speed_over_time_is_the_recorded_one(leg: dict[str, str]) -> None:
    start = Position(float(leg["east_m"]), float(leg["north_m"]), ALTITUDE_M)
    motion = Motion(0.0, arducopter.waypoint_leg(start, target(leg), ground_speed_m_s=4.0), target(leg))
    recorded_m_s = [float(speed) for speed in leg["speeds_m_s"].split()]
    squares = [
        (motion.velocity(SAMPLE_S * number).speed_m_s - speed_m_s) ** 2
        for number, speed_m_s in enumerate(recorded_m_s)
    ]
    assert math.sqrt(sum(squares) / len(squares)) <= 0.15


def test_it_returns_from_afar_in_the_recorded_time() -> None:
    phases = arducopter.return_and_land(Position(200.0, 200.2, ALTITUDE_M), Position(0.0, 0.0))
    assert duration_s(phases) == pytest.approx(66.5, rel=0.02)
    assert phases[-1].end.altitude_m == pytest.approx(0.0)


def test_it_lifts_off_late_and_climbs_no_faster_than_it_can() -> None:
    climb = Motion(0.0, arducopter.takeoff(Position(3.0, 4.0), ALTITUDE_M), Position(3.0, 4.0, ALTITUDE_M))
    assert climb.position(3.4).altitude_m == 0.0
    assert climb.position(6.4).altitude_m == pytest.approx(4.57, abs=0.25)  # as recorded
    assert max(climb.velocity(0.1 * tenth).up_m_s for tenth in range(130)) == pytest.approx(2.54, abs=0.005)


def test_from_below_it_climbs_before_it_returns() -> None:
    way = Motion(
        0.0, arducopter.return_and_land(Position(50.0, 0.0, 5.0), Position(0.0, 0.0)), Position(0.0, 0.0)
    )
    assert max(way.position(0.5 * half).altitude_m for half in range(160)) == pytest.approx(15.0)


@given(
    length_m=st.floats(0.01, 2000.0),
    ground_speed_m_s=st.floats(0.2, 20.0),
    bearing_deg=st.floats(0.0, 360.0),
    climb_m=st.floats(-10.0, 10.0),
)
def test_a_leg_of_any_length_and_speed_is_flown_to_its_end(
    length_m: float, ground_speed_m_s: float, bearing_deg: float, climb_m: float
) -> None:
    start = Position(-7.0, 9.0, ALTITUDE_M)
    bearing = math.radians(bearing_deg)
    end = Position(
        start.east_m + length_m * math.sin(bearing),
        start.north_m + length_m * math.cos(bearing),
        ALTITUDE_M + climb_m,
    )
    phases = arducopter.waypoint_leg(start, end, ground_speed_m_s=ground_speed_m_s)
    assert distance_m(phases[-1].end, end) < 1e-6
    motion, lasts_s = Motion(0.0, phases, end), duration_s(phases)
    samples = [motion.position(lasts_s * number / 200) for number in range(201)]
    assert all(distance_m(place, end) <= length_m + abs(climb_m) + 1e-6 for place in samples)
    arrival_s = arducopter.arrival_s(phases)
    for number in range(1, 40 if length_m > 4 else 1):  # a short one may count as flown before it is fast
        assert distance_m(motion.position(arrival_s + number / 10), end) <= 1.0 + 1e-6
        assert motion.velocity(arrival_s + number / 10).speed_m_s <= 0.5 + 1e-6
    for number in range(200):
        assert motion.velocity(lasts_s * number / 200).speed_m_s <= 1.04 * ground_speed_m_s + 0.02
    assert distance_m(motion.position(arrival_s), end) <= 1.0 + 1e-6
    assert motion.velocity(arrival_s).speed_m_s <= 0.5 + 1e-6


@given(st.floats(0.2, 12.0), st.lists(st.floats(0.1, 500.0), min_size=2, max_size=5))
def test_a_longer_leg_takes_longer(ground_speed_m_s: float, lengths_m: list[float]) -> None:
    def leg_s(length_m: float) -> float:
        start, end = Position(0.0, 0.0, ALTITUDE_M), Position(length_m, 0.0, ALTITUDE_M)
        return arducopter.arrival_s(arducopter.waypoint_leg(start, end, ground_speed_m_s=ground_speed_m_s))

    times_s = [leg_s(length_m) for length_m in sorted(lengths_m)]
    assert all(earlier_s <= later_s + 1e-6 for earlier_s, later_s in itertools.pairwise(times_s))


def test_a_scenario_flies_by_the_profile() -> None:
    legs = scenario(columns=3, rows=2, **PROFILED)
    arrivals_s = [event.t for event in simulate(legs).events if event.kind == "arrived"]
    steps_s = [later_s - earlier_s for earlier_s, later_s in itertools.pairwise(arrivals_s)]
    assert steps_s == pytest.approx([HEAVY_S + 1.0 + 7.3] * 5, rel=0.01)


def test_noise_stretches_its_legs() -> None:
    noisy = scenario(columns=3, rows=2, noise={"leg": 0.2}, **PROFILED)
    arrivals_s = [event.t for event in simulate(noisy).events if event.kind == "arrived"]
    steps_s = [later_s - earlier_s for earlier_s, later_s in itertools.pairwise(arrivals_s)]
    assert len(set(steps_s)) == 5
    assert all(0.5 * 7.3 < step_s - HEAVY_S - 1.0 < 2.0 * 7.3 for step_s in steps_s)
