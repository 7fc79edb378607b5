from __future__ import annotations

import math

import pytest

from upwash.core.geo import GeoPosition, Position, distance_m
from upwash.errors import UsageError
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.copter import LandedState, Result

SETTINGS = VehicleSettings(
    home=GeoPosition(39.3666, 22.9507), acceleration_m_s2=1.0, ground_speed_m_s=4.0, armable_after_s=30.0
)


def flying(altitude_m: float = 20.0) -> tuple[Copter, float]:
    """A copter that hovers, and the time."""
    copter = Copter(SETTINGS, now_s=0.0)
    copter.change_mode(30.0, CopterMode.GUIDED)
    assert copter.arm(30.0) is Result.ACCEPTED
    assert copter.take_off(31.0, altitude_m) is Result.ACCEPTED
    return copter, 60.0


def test_a_leg_takes_its_time() -> None:
    copter, now_s = flying()
    target = Position(20.0, 0.0, 20.0)
    copter.steer(now_s, target)
    assert copter.position(now_s + 8.5) != target
    assert copter.position(now_s + 9.0) == target


def test_a_repeated_target_does_not_start_the_leg_again() -> None:
    copter, now_s = flying()
    target = Position(20.0, 0.0, 20.0)
    copter.steer(now_s, target)
    copter.steer(now_s + 4.5, target)
    assert copter.position(now_s + 9.0) == target


@pytest.mark.parametrize(
    "target",
    [
        Position(math.nan, 0.0, 20.0),
        Position(0.0, math.inf, 20.0),
        Position(0.0, 0.0, math.nan),
        Position(20_000.0, 0.0, 20.0),
        Position(5.0, 0.0, -3.0),
    ],
)
def test_it_does_not_move_for_a_target_that_makes_no_sense(target: Position) -> None:
    copter, now_s = flying()
    copter.steer(now_s, target)
    assert copter.position(now_s + 30.0) == Position(0.0, 0.0, 20.0)


def test_a_higher_speed_on_the_way_does_not_stop_it() -> None:
    copter, now_s = flying()
    target = Position(100.0, 0.0, 20.0)
    copter.steer(now_s, target)
    copter.change_speed(now_s + 4.0, 5.0)  # after 8 m, at 4 m/s
    assert copter.velocity(now_s + 4.0).speed_m_s == pytest.approx(4.0)
    assert copter.velocity(now_s + 5.0).speed_m_s == pytest.approx(5.0)
    arrives_s = now_s + 5.0 + (92.0 - 4.5 - 12.5) / 5.0 + 5.0
    assert copter.velocity(arrives_s - 0.1).speed_m_s == pytest.approx(0.1)
    assert copter.position(arrives_s) == target


def test_a_lower_speed_on_the_way_is_kept_too() -> None:
    copter, now_s = flying()
    target = Position(100.0, 0.0, 20.0)
    copter.steer(now_s, target)
    copter.change_speed(now_s + 10.0, 2.0)
    assert copter.velocity(now_s + 20.0).speed_m_s == pytest.approx(2.0)
    assert copter.position(now_s + 100.0) == target


def test_a_new_target_on_the_way_brakes_first() -> None:
    copter, now_s = flying()
    copter.steer(now_s, Position(100.0, 0.0, 20.0))
    turn_s = now_s + 10.0
    before = copter.position(turn_s), copter.velocity(turn_s)
    copter.steer(turn_s, Position(0.0, 0.0, 20.0))
    assert distance_m(copter.position(turn_s), before[0]) < 1e-9
    assert copter.velocity(turn_s) == before[1]
    assert copter.position(turn_s + 4.0).east_m == pytest.approx(before[0].east_m + 8.0)


def test_it_can_fly_again_after_landing() -> None:
    copter, now_s = flying()
    copter.change_mode(now_s, CopterMode.LAND)
    again_s = now_s + 100.0
    copter.change_mode(again_s, CopterMode.GUIDED)
    assert copter.take_off(again_s, 5.0) is Result.FAILED
    copter.arm(again_s)
    assert copter.landed_state(again_s) is LandedState.ON_GROUND
    assert copter.take_off(again_s, 5.0) is Result.ACCEPTED
    assert copter.position(again_s + 30.0) == Position(0.0, 0.0, 5.0)


@pytest.mark.parametrize("number", [3.0, math.nan, math.inf, 4.5])
def test_an_unknown_mode_is_refused(number: float) -> None:
    copter, now_s = flying()
    assert copter.change_mode(now_s, number) is Result.FAILED
    assert copter.mode is CopterMode.GUIDED


def test_a_vehicle_that_could_not_move_is_refused() -> None:
    with pytest.raises(UsageError, match="climb_m_s"):
        VehicleSettings(home=SETTINGS.home, climb_m_s=0.0)
