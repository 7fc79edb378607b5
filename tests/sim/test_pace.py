"""What a forecast believes of ArduCopter and PX4, held against how they fly: legs, take-offs, returns."""

from __future__ import annotations

import statistics
from collections.abc import Callable

import pytest
from tests.core.test_energy import recorded_returns

from upwash.core.geo import Position, Velocity
from upwash.core.planning.legs import ARDUCOPTER, PX4, Leg, Pace
from upwash.core.vehicle.course import Abilities, SetpointCourse
from upwash.core.vehicle.way_home import ARDUCOPTER as ARDUCOPTER_HOME
from upwash.core.vehicle.way_home import PX4 as PX4_HOME
from upwash.core.vehicle.way_home import WayHome, time_home_s
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.kinematics import duration_s
from upwash.vehicle.px4 import airframe as px4

HOME, START = Position(0.0, 0.0), Position(0.0, 0.0, 20.0)
STEP_S = 0.05


def pursued_s(length_m: float, speed_m_s: float) -> float:
    end = Position(length_m, 0.0, 20.0)
    return arducopter.arrival_s(arducopter.waypoint_leg(START, end, ground_speed_m_s=speed_m_s))


def steered_s(length_m: float, speed_m_s: float) -> float:
    """By the setpoints that a PX4 is sent."""
    course = SetpointCourse(START, Velocity(), Abilities())
    course.aim(Position(length_m, 0.0, 20.0), ground_speed_m_s=speed_m_s)
    elapsed_s = 0.0
    while not course.ended:
        course.advance(STEP_S, vehicle=course.position)
        elapsed_s += STEP_S
    return elapsed_s


@pytest.mark.parametrize("speed_m_s", [2.0, 4.0, 6.0, 8.0, 10.0])
@pytest.mark.parametrize("length_m", [5.0, 10.0, 20.0, 40.0, 80.0, 160.0])
@pytest.mark.parametrize(("pace", "takes_s"), [(ARDUCOPTER, pursued_s), (PX4, steered_s)])
def test_a_leg_takes_what_is_believed(
    pace: Pace, takes_s: Callable[[float, float], float], length_m: float, speed_m_s: float
) -> None:
    believed = Leg(length_m, speed_m_s, pace.acceleration_m_s2, pace.settling_s)
    assert believed.duration_s == pytest.approx(takes_s(length_m, speed_m_s), rel=0.02)


@pytest.mark.parametrize("altitude_m", [10.0, 15.0, 20.0, 30.0, 50.0])
@pytest.mark.parametrize(("pace", "airframe"), [(ARDUCOPTER, arducopter), (PX4, px4)])
def test_a_take_off_takes_what_is_believed(pace: Pace, airframe: object, altitude_m: float) -> None:
    whole_s = duration_s(airframe.takeoff(HOME, altitude_m))  # type: ignore[attr-defined]
    assert whole_s - 1.5 <= pace.takeoff_s(altitude_m) <= whole_s  # it counts as there a metre below


@pytest.mark.parametrize(("pace", "way"), [(ARDUCOPTER, ARDUCOPTER_HOME), (PX4, PX4_HOME)])
def test_recorded_returns_took_the_share_that_is_believed(pace: Pace, way: WayHome) -> None:
    shares = [
        took_s / time_home_s(start, HOME, way, velocity=velocity)
        for flown, start, velocity, took_s in recorded_returns()
        if flown == way
    ]
    assert statistics.fmean(shares) == pytest.approx(pace.home_share, abs=0.01)
