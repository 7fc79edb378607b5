"""How a PX4 flies, drawn as phases, for a simulation that needs a whole flight in advance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.way_home import PX4
from upwash.vehicle.body.kinematics import Phase, cruise_m_s, heading_of, pause
from upwash.vehicle.px4.body import (
    CLIMB_M_S,
    CLIMB_RETURNING_M_S,
    CLIMBING_M_S2,
    SINKING_M_S,
    STEP_S,
    Body,
    Steering,
    approach_m_s,
    landing_sink_m_s,
)

returning = PX4

REACTION_S, FOLLOWING_LAG_S = 0.22, 0.34  # of repositions, of setpoints in OFFBOARD
BELIEVES_GROUND_S = 4.7  # after contact, until it counts as landed
ALTITUDE_REACHED_M = 0.8  # NAV_MC_ALT_RAD
spool_up_s = 3.0  # after the command to take off, until it lifts
_ARRIVED_M, _ARRIVED_M_S = 1.0, 0.5  # near and slow enough for the next target
_STILL_M, _STILL_M_S = 0.05, 0.02
_LONGEST_S = 600.0
_SAMPLE_STEPS = 4  # of a phase
_TURNS_AT_ONCE_M_S = 0.5


def waypoint_leg(start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
    """A leg from rest to rest, with the overshoot and the creeping back."""
    return rest_of_leg(start, end, ground_speed_m_s=ground_speed_m_s, speed_m_s=0.0)


def rest_of_leg(
    start: Position, end: Position, *, ground_speed_m_s: float, speed_m_s: float
) -> tuple[Phase, ...]:
    """A leg from that speed to rest; empty if it is faster than it may be, or could not stop in time."""
    length_m = distance_m(start, end)
    cap_m_s = cruise_m_s(start, end, ground_speed_m_s, climb_m_s=CLIMB_RETURNING_M_S, descent_m_s=SINKING_M_S)
    if length_m == 0 or speed_m_s > cap_m_s or speed_m_s > max(approach_m_s(length_m), _TURNS_AT_ONCE_M_S):
        return ()
    return _along(start, heading_of(start, end), _leg_samples(length_m, cap_m_s, speed_m_s))


def brake(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """To rest, straight ahead; the last of its speed takes no time and no way."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s <= _TURNS_AT_ONCE_M_S:
        return ()
    ahead = Position(
        start.east_m + velocity.east_m_s,
        start.north_m + velocity.north_m_s,
        start.altitude_m + velocity.up_m_s,
    )
    return _along(start, heading_of(start, ahead), _brake_samples(speed_m_s))


def arrival_s(phases: tuple[Phase, ...]) -> float:
    """When the vehicle first counts as arrived: within 1 m of the end, below 0.5 m/s, and after it flew."""
    elapsed_s, flew = 0.0, False
    for phase in phases:
        slow = phase.speed_m_s <= _ARRIVED_M_S
        if flew and slow and distance_m(phase.start, phases[-1].end) <= _ARRIVED_M:
            return elapsed_s
        flew = flew or not slow
        elapsed_s += phase.duration_s
    return elapsed_s


def takeoff(ground: Position, altitude_m: float) -> tuple[Phase, ...]:
    """Spools up, then climbs straight up to the altitude."""
    steering = Steering(altitude_m=altitude_m, climb_m_s=CLIMB_M_S, climb_m_s2=CLIMBING_M_S2)
    up = _along(ground, Velocity(up_m_s=1.0), _vertical(ground.altitude_m, lambda _: steering))
    return (pause(ground, spool_up_s), *up)


def return_and_land(start: Position, home: Position) -> tuple[Phase, ...]:
    """Climbs to the altitude of returns if it is lower, flies home and lands."""
    way = way_home(start, home, ground_speed_m_s=RETURN_M_S, altitude_m=RETURN_ALTITUDE_M)
    return *way, *landing(way[-1].end)


RETURN_M_S, RETURN_ALTITUDE_M = 5.0, 30.0  # MPC_XY_CRUISE, RTL_RETURN_ALT


def way_home(
    start: Position, home: Position, *, ground_speed_m_s: float, altitude_m: float
) -> tuple[Phase, ...]:
    """Climbs to the altitude if it is lower, and flies home."""
    top_m = max(start.altitude_m, altitude_m)
    above_start = Position(start.east_m, start.north_m, top_m)
    above_home = Position(home.east_m, home.north_m, top_m)
    steering = Steering(altitude_m=top_m)
    up = _along(start, Velocity(up_m_s=1.0), _vertical(start.altitude_m, lambda _: steering))
    leg = waypoint_leg(above_start, above_home, ground_speed_m_s=ground_speed_m_s)
    here = leg[-1].end if leg else above_home
    return *up, *leg, pause(here, 0.0)


def landing(start: Position) -> tuple[Phase, ...]:
    """Descends to the ground, slowly on the last metres, and waits there until it believes that it has landed."""

    def sinking(altitude_m: float) -> Steering:
        return Steering(altitude_m=-math.inf, sink_m_s=landing_sink_m_s(altitude_m))

    down = _along(start, Velocity(up_m_s=1.0), _vertical(start.altitude_m, sinking))
    ground = Position(start.east_m, start.north_m)
    return *down, pause(ground, BELIEVES_GROUND_S)


@dataclass(frozen=True, slots=True)
class _Sample:
    time_s: float
    way_m: float
    speed_m_s: float


@lru_cache(maxsize=512)
def _leg_samples(length_m: float, cap_m_s: float, speed_m_s: float) -> tuple[_Sample, ...]:
    steering = Steering(place=Position(length_m, 0.0), cap_m_s=cap_m_s)
    body = Body()
    if speed_m_s:
        body.cruise(speed_m_s)

    def done() -> bool:
        return abs(length_m - body.place_m.real) <= _STILL_M and abs(body.ground_m_s.real) <= _STILL_M_S

    samples = [_Sample(0.0, 0.0, speed_m_s)]
    waits_s = 0.0 if speed_m_s else REACTION_S
    if waits_s:
        samples.append(_Sample(waits_s, 0.0, 0.0))
    _sample(samples, body, lambda: steering, done, lambda: (body.place_m.real, body.ground_m_s.real))
    last = samples[-1]
    return (*samples, _Sample(last.time_s + STEP_S, length_m, 0.0))


@lru_cache(maxsize=64)
def _brake_samples(speed_m_s: float) -> tuple[_Sample, ...]:
    body, steering = Body(), Steering()
    body.cruise(speed_m_s)
    samples = [_Sample(0.0, 0.0, speed_m_s)]
    _sample(
        samples,
        body,
        lambda: steering,
        lambda: body.ground_m_s.real <= _STILL_M_S,
        lambda: (body.place_m.real, max(0.0, body.ground_m_s.real)),
    )
    return (*samples, _Sample(samples[-1].time_s + STEP_S, samples[-1].way_m, 0.0))


def _vertical(altitude_m: float, steering: Callable[[float], Steering]) -> tuple[_Sample, ...]:
    """From rest to the steering's altitude, or to the ground."""
    body = Body(altitude_m=altitude_m)
    end_m = max(0.0, steering(altitude_m).altitude_m or 0.0)

    def done() -> bool:
        return abs(body.altitude_m - end_m) <= _STILL_M or (end_m == 0 and body.altitude_m <= 0)

    samples = [_Sample(0.0, 0.0, 0.0)]
    if done():
        return tuple(samples)
    _sample(
        samples,
        body,
        lambda: steering(body.altitude_m),
        done,
        lambda: (body.altitude_m - altitude_m, body.up_m_s),
    )
    last = samples[-1]
    return (*samples[:-1], _Sample(last.time_s, end_m - altitude_m, 0.0))


def _sample(
    samples: list[_Sample],
    body: Body,
    steering: Callable[[], Steering],
    done: Callable[[], bool],
    state: Callable[[], tuple[float, float]],
) -> None:
    begun_s, steps = samples[-1].time_s, 0
    while not done() and steps * STEP_S < _LONGEST_S:
        body.step(steering())
        steps += 1
        if steps % _SAMPLE_STEPS == 0 or done():
            samples.append(_Sample(begun_s + steps * STEP_S, *state()))


def _along(start: Position, heading: Velocity, samples: Sequence[_Sample]) -> tuple[Phase, ...]:
    """The samples' way along a line, as phases, each under a constant jerk; two where it turns back."""
    phases: list[Phase] = []
    here = start
    for before, after in pairwise(samples):
        lasts_s = after.time_s - before.time_s
        if before.speed_m_s * after.speed_m_s < 0:
            until_s = lasts_s * before.speed_m_s / (before.speed_m_s - after.speed_m_s)
            pieces = [
                (until_s, before.speed_m_s, 0.0, before.speed_m_s * until_s / 2),
                (lasts_s - until_s, 0.0, after.speed_m_s, after.speed_m_s * (lasts_s - until_s) / 2),
            ]
        else:
            pieces = [(lasts_s, before.speed_m_s, after.speed_m_s, after.way_m - before.way_m)]
        for piece in pieces:
            phases.append(_phase(here, heading, piece))
            here = phases[-1].end
    return tuple(phases)


def _phase(here: Position, heading: Velocity, piece: tuple[float, float, float, float]) -> Phase:
    lasts_s, from_m_s, to_m_s, way_m = piece
    if from_m_s + to_m_s < 0 or (from_m_s + to_m_s == 0 and way_m < 0):
        heading = Velocity(-heading.east_m_s, -heading.north_m_s, -heading.up_m_s)
        from_m_s, to_m_s, way_m = -from_m_s, -to_m_s, -way_m
    mean_m = (from_m_s + to_m_s) / 2 * lasts_s
    acceleration_m_s2 = 2 * (3 * way_m - (2 * from_m_s + to_m_s) * lasts_s) / lasts_s**2
    return Phase(
        here, heading, from_m_s, acceleration_m_s2, lasts_s, jerk_m_s3=12 * (mean_m - way_m) / lasts_s**3
    )
