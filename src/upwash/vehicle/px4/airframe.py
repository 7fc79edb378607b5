"""How a PX4 flies, drawn as phases, for a simulation that needs a whole flight in advance."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import TypeAlias

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.course import Abilities, SetpointCourse
from upwash.core.vehicle.way_home import PX4
from upwash.vehicle.body.kinematics import Phase, along, cruise_m_s, direction_of, down_to, heading_of, pause
from upwash.vehicle.px4.body import (
    CLIMB_M_S,
    CLIMB_RETURNING_M_S,
    CLIMBING_M_S2,
    SINKING_M_S,
    STEP_S,
    Body,
    Steering,
    landing_sink_m_s,
)

returning = PX4

REACTION_S, FOLLOWING_LAG_S = 0.22, 0.34  # of repositions, of setpoints in OFFBOARD
_LATE_STEPS = round(FOLLOWING_LAG_S / STEP_S)
BELIEVES_GROUND_S = 4.7  # after contact, until it counts as landed
ALTITUDE_REACHED_M = 0.8  # NAV_MC_ALT_RAD
LANDS_WITHIN_M = 2.0  # of home, on the way there
spool_up_s = 3.0  # after the command to take off, until it lifts
_ARRIVED_M, _ARRIVED_M_S = 1.0, 0.5  # near and slow enough for the next target
_STILL_M, _STILL_M_S = 0.05, 0.02
_LONGEST_S = 600.0
_SAMPLE_STEPS = 4  # of a phase
_TURNS_AT_ONCE_M_S = 0.5
_UP, _AT_REST = Velocity(up_m_s=1.0), (0.0, 0.0, 0.0)
_RETURN_M_S, _RETURN_ALTITUDE_M = 5.0, 30.0  # MPC_XY_CRUISE, RTL_RETURN_ALT


def waypoint_leg(start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
    """The motion of a leg that upwash's setpoints lead from rest to rest, with the overshoot and the way back."""
    length_m = distance_m(start, end)
    if length_m == 0:
        return ()
    cap_m_s = cruise_m_s(start, end, ground_speed_m_s, climb_m_s=CLIMB_RETURNING_M_S, descent_m_s=SINKING_M_S)
    return _along(start, heading_of(start, end), _led_samples(length_m, cap_m_s))


def brake(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """The motion from the velocity to rest, straight ahead; empty at a speed at which the vehicle turns at once."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s <= _TURNS_AT_ONCE_M_S:
        return ()
    return _along(start, direction_of(velocity), _brake_samples(speed_m_s))


def hold(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """The motion of a hold that upwash's setpoints lead; empty at rest."""
    speed_m_s = velocity.speed_m_s
    return _along(start, direction_of(velocity), _held_samples(speed_m_s)) if speed_m_s > 0 else ()


def arrival_s(phases: tuple[Phase, ...]) -> float:
    """The second of the arrival: first within 1 m of the end and below 0.5 m/s, after it has flown."""
    elapsed_s, flew = 0.0, False
    for phase in phases:
        slow = phase.speed_m_s <= _ARRIVED_M_S
        if flew and slow and distance_m(phase.start, phases[-1].end) <= _ARRIVED_M:
            return elapsed_s
        flew = flew or not slow
        elapsed_s += phase.duration_s
    return elapsed_s


def takeoff(ground: Position, altitude_m: float) -> tuple[Phase, ...]:
    """The motion of a take-off: the motors spool up, then the vehicle climbs straight up to the altitude."""
    steering = Steering(altitude_m=altitude_m, climb_m_s=CLIMB_M_S, climb_m_s2=CLIMBING_M_S2)
    up = _along(ground, _UP, _vertical(ground.altitude_m, lambda _: steering))
    return (pause(ground, spool_up_s), *up)


def return_and_land(start: Position, home: Position) -> tuple[Phase, ...]:
    """The motion of a return: a climb to the altitude of returns if the vehicle is lower, home, landing.

    At the altitude of `home` above the ground the landing ends.
    """
    top_m = max(start.altitude_m, _RETURN_ALTITUDE_M)
    above_start, above_home = start.at_altitude(top_m), home.at_altitude(top_m)
    steering = Steering(altitude_m=top_m)
    up = _along(start, _UP, _vertical(start.altitude_m, lambda _: steering, within_m=ALTITUDE_REACHED_M))
    length_m = distance_m(above_start, above_home)
    if length_m <= LANDS_WITHIN_M:
        leg = waypoint_leg(above_start, above_home, ground_speed_m_s=_RETURN_M_S)
    else:
        leg = _along(
            above_start,
            heading_of(above_start, above_home),
            _return_samples(length_m),
        )
    here = leg[-1].end if leg else above_home
    return *up, *leg, pause(here, 0.0), *down_to(landing(here), home.altitude_m)


def landing(start: Position) -> tuple[Phase, ...]:
    """The motion of a landing, slow on the last metres, and the wait until the vehicle reports that it has landed."""

    def sinking(body: Body) -> Steering:
        return Steering(altitude_m=-math.inf, sink_m_s=landing_sink_m_s(body.altitude_m))

    down = _along(start, _UP, _vertical(start.altitude_m, sinking))
    ground = Position(start.east_m, start.north_m)
    return *down, pause(ground, BELIEVES_GROUND_S)


_Sample: TypeAlias = tuple[float, float, float]  # a time, the way until then, and the speed


@lru_cache(maxsize=512)
def _return_samples(length_m: float) -> tuple[_Sample, ...]:
    """A way home from rest: from where the landing begins it brakes evenly."""
    steering = Steering(place=Position(length_m, 0.0), cap_m_s=_RETURN_M_S)

    def is_over(body: Body) -> bool:
        left_m, speed_m_s = length_m - body.place_m.real, body.ground_m_s.real
        return 0 < left_m <= LANDS_WITHIN_M or (abs(left_m) <= _STILL_M and abs(speed_m_s) <= _STILL_M_S)

    flown = _flown(
        Body(), lambda _: steering, is_over, lambda body: (body.place_m.real, body.ground_m_s.real)
    )
    samples = [(REACTION_S + time_s, way_m, speed_m_s) for time_s, way_m, speed_m_s in (_AT_REST, *flown)]
    ends_s, ends_m, speed_m_s = samples[-1]
    return (_AT_REST, *samples, (ends_s + 2 * (length_m - ends_m) / speed_m_s, length_m, 0.0))


@lru_cache(maxsize=512)
def _led_samples(length_m: float, cap_m_s: float) -> tuple[_Sample, ...]:
    """A leg from rest to rest behind a course."""
    course = SetpointCourse(Position(0.0, 0.0), Velocity(), Abilities())
    course.aim(Position(length_m, 0.0), ground_speed_m_s=cap_m_s)

    def rests(body: Body) -> bool:
        left_m, speed_m_s = length_m - body.place_m.real, body.ground_m_s.real
        return abs(left_m) <= _STILL_M and abs(speed_m_s) <= _STILL_M_S

    samples = (_AT_REST, *_led(Body(), course, rests))
    return (*samples, (samples[-1][0] + STEP_S, length_m, 0.0))


@lru_cache(maxsize=64)
def _held_samples(speed_m_s: float) -> tuple[_Sample, ...]:
    """A hold behind a course; it ends where the body first rests, beyond the end of the course."""
    course = SetpointCourse(Position(_LATE_STEPS * STEP_S * speed_m_s, 0.0), Velocity(speed_m_s), Abilities())
    course.stop()
    body = Body()
    body.cruise(speed_m_s)
    samples = ((0.0, 0.0, speed_m_s), *_led(body, course, lambda body: body.ground_m_s.real <= _STILL_M_S))
    time_s, way_m, _ = samples[-1]
    return (*samples, (time_s + STEP_S, way_m, 0.0))


def _led(body: Body, course: SetpointCourse, rests: Callable[[Body], bool]) -> Iterator[_Sample]:
    """The way and the speed of a body that follows a course until it rests; it follows late."""
    velocity = Velocity(body.ground_m_s.real)
    ways_m = [velocity.east_m_s * STEP_S * step for step in range(1, _LATE_STEPS + 1)]
    waiting = deque(_follow(Position(way_m, 0.0), velocity) for way_m in ways_m)

    def steering(body: Body) -> Steering:
        course.advance(STEP_S, vehicle=body.position)
        waiting.append(_follow(course.position, course.setpoint_velocity))
        return waiting.popleft()

    def done(body: Body) -> bool:
        return course.ended and rests(body)

    yield from _flown(body, steering, done, lambda body: (body.place_m.real, body.ground_m_s.real))


def _follow(place: Position, velocity: Velocity) -> Steering:
    return Steering(place=place, cap_m_s=Abilities().ground_speed_m_s, stiffly=True, velocity=velocity)


@lru_cache(maxsize=64)
def _brake_samples(speed_m_s: float) -> tuple[_Sample, ...]:
    body, steering = Body(), Steering()
    body.cruise(speed_m_s)
    flown = _flown(
        body,
        lambda _: steering,
        lambda body: body.ground_m_s.real <= _STILL_M_S,
        lambda body: (body.place_m.real, max(0.0, body.ground_m_s.real)),
    )
    samples = ((0.0, 0.0, speed_m_s), *flown)
    time_s, way_m, _ = samples[-1]
    return (*samples, (time_s + STEP_S, way_m, 0.0))


def _vertical(
    altitude_m: float, steering: Callable[[Body], Steering], *, within_m: float = _STILL_M
) -> tuple[_Sample, ...]:
    """Samples of a climb or descent from rest to the steering's altitude, or to the ground."""
    body = Body(altitude_m=altitude_m)
    end_m = max(0.0, steering(body).altitude_m or 0.0)

    def there(body: Body) -> bool:
        return abs(body.altitude_m - end_m) <= within_m or (end_m == 0 and body.altitude_m <= 0)

    flown = tuple(_flown(body, steering, there, lambda body: (body.altitude_m - altitude_m, body.up_m_s)))
    return (_AT_REST, *flown[:-1], (flown[-1][0], end_m - altitude_m, 0.0)) if flown else (_AT_REST,)


def _flown(
    body: Body,
    steering: Callable[[Body], Steering],
    done: Callable[[Body], bool],
    state: Callable[[Body], tuple[float, float]],
) -> Iterator[_Sample]:
    """The way and the speed of a body until it is done, at some of its steps."""
    steps = 0
    while not done(body) and steps * STEP_S < _LONGEST_S:
        body.step(steering(body))
        steps += 1
        if steps % _SAMPLE_STEPS == 0 or done(body):
            yield steps * STEP_S, *state(body)


def _along(start: Position, heading: Velocity, samples: Sequence[_Sample]) -> tuple[Phase, ...]:
    """The samples' way along a line, as phases; two where it turns back."""
    return along(start, heading, (stretch for pair in pairwise(samples) for stretch in _stretches(*pair)))


def _stretches(before: _Sample, after: _Sample) -> Iterator[tuple[float, float, float, float]]:
    (begins_s, begins_m, from_m_s), (ends_s, ends_m, to_m_s) = before, after
    lasts_s = ends_s - begins_s
    way_m = ends_m - begins_m
    if from_m_s * to_m_s < 0:
        until_s = lasts_s * from_m_s / (from_m_s - to_m_s)
        there_m = from_m_s * until_s / 2
        yield there_m, from_m_s, 0.0, until_s
        yield way_m - there_m, 0.0, to_m_s, lasts_s - until_s
    else:
        yield way_m, from_m_s, to_m_s, lasts_s
