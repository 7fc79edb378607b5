"""The moving point that leads a PX4: 1.2 m/s² of its 3 m/s² are used, and the point rests at its target."""

from __future__ import annotations

import itertools
import math

import pytest

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.course import Abilities, SetpointCourse

STEP_S = 0.05
USED_M_S2 = 0.4 * 3.0
HERE = Position(10.0, 20.0, 30.0)


def course(velocity: Velocity = Velocity()) -> SetpointCourse:  # noqa: B008 - frozen
    return SetpointCourse(HERE, velocity, Abilities())


def leg(target: Position, *, ground_speed_m_s: float = 5.0) -> tuple[list[Position], list[Velocity]]:
    """The places and velocities of a point, from step to step, until it has ended at the target."""
    point = course()
    point.aim(target, ground_speed_m_s=ground_speed_m_s)
    places, velocities = [point.position], [point.velocity]
    while not point.ended:
        point.advance(STEP_S, vehicle=point.position)
        places.append(point.position)
        velocities.append(point.velocity)
        assert len(places) < 10_000
    return places, velocities


def target(east_m: float, north_m: float = 0.0, up_m: float = 0.0) -> Position:
    return Position(HERE.east_m + east_m, HERE.north_m + north_m, HERE.altitude_m + up_m)


def test_it_accelerates_cruises_brakes_and_rests_at_the_target() -> None:
    places, velocities = leg(target(60.0))
    speeds_m_s = [velocity.speed_m_s for velocity in velocities]
    assert speeds_m_s[:80] == pytest.approx([step * USED_M_S2 * STEP_S for step in range(80)])
    assert max(speeds_m_s) == 5.0
    assert places[-1] == target(60.0)
    assert speeds_m_s[-1] == 0.0
    took_s = (len(places) - 1) * STEP_S
    assert 60.0 / 5.0 + 5.0 / (2 * USED_M_S2) < took_s < 60.0 / 5.0 + 3 * 5.0 / (2 * USED_M_S2) + 2.0
    for place, velocity in zip(places[-60:-1], velocities[-60:-1], strict=True):
        left_m = distance_m(place, places[-1])
        assert velocity.speed_m_s <= min(math.sqrt(2 * USED_M_S2 * left_m), 0.7 * left_m) + 0.3
        assert place.east_m <= places[-1].east_m
    changes = [after - before for before, after in itertools.pairwise(speeds_m_s)]
    assert max(changes) == pytest.approx(USED_M_S2 * STEP_S)
    assert min(changes[:-1]) >= -2 * USED_M_S2 * STEP_S - 1e-9


@pytest.mark.parametrize(
    ("way", "speed_m_s"),
    [
        ((240.0, 0.0, 0.0), 12.0),  # it can fly no faster
        ((0.0, 0.0, 40.0), 3.0),
        ((0.0, 0.0, -25.0), 1.5),
        ((30.0, 40.0, 50.0), 3.0 * math.sqrt(2.0)),
        ((30.0, -40.0, -20.0), 1.5 * math.hypot(50.0, 20.0) / 20.0),
    ],
)
def test_it_climbs_and_descends_as_fast_as_the_vehicle_can(
    way: tuple[float, float, float], speed_m_s: float
) -> None:
    places, velocities = leg(target(*way), ground_speed_m_s=20.0)
    fastest = max(velocities, key=lambda velocity: velocity.speed_m_s)
    assert fastest.speed_m_s == pytest.approx(speed_m_s)
    length_m = math.hypot(*way)
    flown = (fastest.east_m_s, fastest.north_m_s, fastest.up_m_s)
    assert flown == pytest.approx([part / length_m * speed_m_s for part in way])
    assert places[-1] == target(*way)


def test_a_slanted_leg_keeps_the_ground_speed_and_brakes_as_gently_as_it_accelerates() -> None:
    places, velocities = leg(target(30.0, 40.0, 50.0), ground_speed_m_s=2.0)
    assert max(math.hypot(velocity.east_m_s, velocity.north_m_s) for velocity in velocities) == pytest.approx(
        2.0
    )
    places, velocities = leg(target(60.0))
    braking = [
        (distance_m(place, places[-1]), velocity.speed_m_s)
        for place, velocity in zip(places, velocities, strict=True)
        if 6.0 < distance_m(place, places[-1]) < 9.0
    ]
    for left_m, speed_m_s in braking:
        assert speed_m_s == pytest.approx(math.sqrt(2 * USED_M_S2 * left_m), abs=0.1)


def test_a_target_nearby_is_taken_at_once_and_one_out_of_reach_is_not() -> None:
    point = course()
    point.aim(target(0.09), ground_speed_m_s=5.0)
    point.advance(STEP_S, vehicle=HERE)
    assert (point.position, point.ended) == (target(0.09), True)
    point = SetpointCourse(Position(0.0, 0.0), Velocity(), Abilities())
    point.aim(Position(0.1, 0.0), ground_speed_m_s=5.0)
    point.advance(STEP_S, vehicle=point.position)
    assert point.ended, "at the edge of what is nearby it does not stand still either"
    point = course()
    point.aim(target(0.2), ground_speed_m_s=5.0)
    point.advance(STEP_S, vehicle=HERE)
    assert distance_m(HERE, point.position) < 0.01
    assert not point.ended
    fast = course(Velocity(east_m_s=4.0))
    fast.aim(target(0.38), ground_speed_m_s=5.0)
    fast.advance(STEP_S, vehicle=HERE)
    assert fast.position == target(0.38), "it is half a step away"
    fast = course(Velocity(east_m_s=4.0))
    fast.aim(target(0.5), ground_speed_m_s=5.0)
    fast.advance(STEP_S, vehicle=HERE)
    assert fast.position != target(0.5), "it is more than a step away"


@pytest.mark.parametrize(
    ("speed_m_s", "behind_m", "share"),
    [
        (5.0, 0.0, 1.0),
        (5.0, 3.0, 1.0),
        (5.0, 4.5, 0.5),
        (5.0, 6.0, 0.0),
        (5.0, 9.0, 0.0),
        (10.0, 6.0, 1.0),  # 0.6 s behind
        (10.0, 9.0, 0.5),
    ],
)
def test_it_waits_for_a_vehicle_that_falls_behind(speed_m_s: float, behind_m: float, share: float) -> None:
    point = course(Velocity(east_m_s=speed_m_s))
    point.aim(target(99.0), ground_speed_m_s=speed_m_s)
    point.advance(1.0, vehicle=target(-behind_m))
    assert point.position == target(speed_m_s * share)
    assert point.setpoint_velocity == Velocity(east_m_s=speed_m_s * share)
    assert point.velocity == Velocity(east_m_s=speed_m_s)


def test_the_push_is_the_change_of_the_velocity() -> None:
    point = course()
    point.aim(target(0.0, 50.0), ground_speed_m_s=5.0)
    point.advance(STEP_S, vehicle=HERE)
    assert point.setpoint_acceleration.north_m_s == pytest.approx(USED_M_S2)
    assert point.setpoint_velocity == point.velocity
    assert point.velocity.north_m_s == point.velocity.speed_m_s == pytest.approx(USED_M_S2 * STEP_S)
    point.advance(STEP_S, vehicle=HERE)
    assert point.setpoint_acceleration.north_m_s == pytest.approx(USED_M_S2)
    point.advance(0.0, vehicle=HERE)
    assert (point.setpoint_velocity, point.setpoint_acceleration) == (Velocity(), Velocity())


def test_without_a_target_it_brakes_to_the_place_that_it_announced() -> None:
    point = course(Velocity(3.0, -4.0, 0.0))
    point.aim(target(99.0), ground_speed_m_s=5.0)
    assert not point.ended
    point.stop()
    announced = point.stopping_place
    assert distance_m(announced, HERE) == pytest.approx(5.0**2 / (2 * USED_M_S2))
    steps = 0
    while not point.ended:
        point.advance(STEP_S, vehicle=point.position)
        steps += 1
    assert steps * STEP_S == pytest.approx(5.0 / USED_M_S2, abs=STEP_S)
    assert distance_m(point.position, announced) < 0.3
