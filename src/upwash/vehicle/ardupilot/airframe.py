"""How an ArduCopter flies, as its flights show (SITL, version 4.7, default parameters, no wind).

Its legs in GUIDED are a pursuit: it overshoots its target by 0.4 to 0.8 m and creeps back. The gains and limits
were found from recorded legs of 20 to 60 m at 2.5 to 9 m/s. Its returns are along smooth ramps, without overshoot.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import lru_cache

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.way_home import ARDUCOPTER
from upwash.vehicle.ardupilot.pursuit import Pursuit, PursuitSample
from upwash.vehicle.ardupilot.ramps import Ramp, ramped_leg
from upwash.vehicle.body.kinematics import (
    CombinedMotion,
    Curve,
    Motion,
    MotionPart,
    Phase,
    along,
    cruise_m_s,
    direction_of,
    down_to,
    duration_s,
    heading_of,
    last_true,
    leg,
    pause,
    steadily,
)

_REACTION_S = 0.1
_GUIDED = Pursuit(
    acceleration_m_s2=2.42,
    braking_m_s2=1.30,
    jerk_m_s3=7.7,
    place_gain_per_s=1.02,
    speed_gain_per_s=1.79,
    following_per_s=1.5,
    correcting_per_s=1.13,
    learning_per_s2=0.325,
    motors_s=0.12,
    drag_per_s=0.22,
    foresight=0.96,
)
_STOPS_M_S2 = 1.83  # the deceleration that the driver of an ArduCopter assumes
_ARRIVED_M, _ARRIVED_M_S = 1.0, 0.5  # near and slow enough for the next target
_FINEST_M = 1e-6  # legs that differ by less are flown alike

_BRAKING = Ramp(((0.73, -0.97), (1.03, -1.83), (2.4, 0.0)))

spool_up_s = 3.4  # after arming, until it lifts
_CLIMB_M_S = 2.535
_LIFTING = Ramp(
    ((0.4, 1.0), (0.15, 2.9), (0.15, 2.9), (0.2, 0.01), (0.2, 0.01), (0.2, 1.0), (1.05, 1.0), (0.33, 0.0))
)
_LEVELLING = Ramp(((0.3, -0.65), (3.6, -0.65), (0.3, 0.0)))

_RETURN_M_S = 10.0
_RETURN_FASTER = Ramp(((0.6, 0.75), (2.0, 2.2), (1.4, 2.0), (1.5, 0.7), (1.0, 0.0)))
_RETURN_SLOWER = Ramp(((0.8, -0.7), (2.0, -2.35), (1.5, -2.4), (1.2, 0.0)))
_RETURN_ALTITUDE_M = 15.0  # it climbs so high before it returns
_RETURN_CLIMB_REACTION_S, _RETURN_REACTION_S = 0.4, 1.1
_RETURN_CLIMBING = Ramp(((1.2, 0.93), (0.7, 0.93), (0.9, 0.0)))
_RETURN_LEVELLING = Ramp(((1.0, -0.93), (0.7, -0.93), (1.0, 0.0)))
_LEAVES_EARLY_S = 2.4  # before it has climbed all the way
_HOVER_S = 5.4
_DESCENT_REACTION_S = 0.2
_DESCENT_M_S, _DESCENT_M_S2 = 1.5, 1.0
_SLOWLY_BELOW_M, _LANDING_M_S = 10.0, 0.5
returning = ARDUCOPTER
TURN_DEG_S = 65.0

_KNOT_SAMPLES = 3
_LONGEST_SAMPLES = 48
_KNOT_M_S = 0.03  # how far a phase may be from the pursuit that it is made of


def waypoint_leg(start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
    """The motion of a leg from rest to rest, with the time that the vehicle takes to react."""
    length_m = distance_m(start, end)
    if length_m < _FINEST_M:
        return (pause(end, _REACTION_S),)
    parts = _chased(round(length_m / _FINEST_M) * _FINEST_M, _cruise_m_s(start, end, ground_speed_m_s))
    reacting = pause(start, _REACTION_S)
    return reacting, *along(reacting.end, heading_of(start, end), parts)


def redirected(
    start: Position,
    velocity: Velocity,
    end: Position,
    *,
    ground_speed_m_s: float,
    rests_at: Position | None = None,
) -> tuple[MotionPart, ...]:
    """The motion from the present velocity to rest at `end`, a new target or the old one at a new speed.

    `rests_at` is the former target, where the vehicle has all but arrived: it is still pulled there.
    """
    length_m = distance_m(start, end)
    ahead = heading_of(start, end) if length_m else direction_of(velocity)
    along_m_s = _product(velocity, ahead)
    across = Velocity(
        velocity.east_m_s - along_m_s * ahead.east_m_s,
        velocity.north_m_s - along_m_s * ahead.north_m_s,
        velocity.up_m_s - along_m_s * ahead.up_m_s,
    )
    aside = direction_of(across)
    cruise_m_s = _cruise_m_s(start, end, ground_speed_m_s)
    rests_m = None
    if rests_at is not None:
        off_m = _between(start, rests_at)
        rests_m = complex(_product(off_m, ahead), _product(off_m, aside))
    speeds_m_s = complex(along_m_s, across.speed_m_s)
    samples = _GUIDED.chase(length_m, speeds_m_s, cruise_m_s=cruise_m_s, rests_m=rests_m)
    knots = _thinned(list(samples))
    return tuple(
        Curve(
            _place(start, ahead, aside, before.place_m),
            _vector(ahead, aside, before.velocity_m_s),
            _place(start, ahead, aside, after.place_m),
            _vector(ahead, aside, after.velocity_m_s),
            after.elapsed_s - before.elapsed_s,
        )
        for before, after in itertools.pairwise(knots)
    )


def brake(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """The motion from the velocity to rest, straight ahead; empty at rest."""
    speed_m_s = velocity.speed_m_s
    return _BRAKING.phases(start, direction_of(velocity), speed_m_s) if speed_m_s > 0 else ()


def hold(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """The motion of a hold by upwash's driver: to a target ahead where the vehicle can stop; empty at rest."""
    speed_m_s = velocity.speed_m_s
    return along(start, direction_of(velocity), _held(speed_m_s)) if speed_m_s > 0 else ()


def arrival_s(phases: tuple[Phase, ...]) -> float:
    """The second of the arrival: within 1 m of the end and below 0.5 m/s."""
    if not phases:
        return 0.0
    begun_s, end = 0.0, phases[-1].end
    for phase in phases:

        def is_unsettled(elapsed_s: float, phase: Phase = phase) -> bool:
            left_m = distance_m(phase.position(elapsed_s), end)
            return left_m > _ARRIVED_M or phase.velocity(elapsed_s).speed_m_s > _ARRIVED_M_S

        if not is_unsettled(0.0):
            return begun_s
        if not is_unsettled(phase.duration_s):
            return begun_s + last_true(is_unsettled, phase.duration_s)
        begun_s += phase.duration_s
    return begun_s


def takeoff(ground: Position, altitude_m: float) -> tuple[Phase, ...]:
    """The motion of a take-off: the motors spool up, then the vehicle climbs straight up to the altitude."""
    up = Position(ground.east_m, ground.north_m, altitude_m)
    climb = ramped_leg(ground, up, cruise_m_s=_CLIMB_M_S, faster=_LIFTING, slower=_LEVELLING)
    return (pause(ground, spool_up_s), *climb)


def return_and_land(start: Position, home: Position) -> tuple[Phase, ...]:
    """The motion of a return: a climb to the altitude of returns if the vehicle is lower, home, hover, landing.

    At the altitude of `home` above the ground the landing ends.
    """
    climb = _return_climb(start, _RETURN_ALTITUDE_M)
    way = _way_from_above(climb[-1].end, home, ground_speed_m_s=_RETURN_M_S, climbed=len(climb) > 1)
    return *climb, *way, *down_to(landing(way[-1].end), home.altitude_m)


def way_home(
    start: Position, velocity: Velocity, home: Position, *, ground_speed_m_s: float, altitude_m: float
) -> tuple[MotionPart, ...]:
    """The motion of a return until the landing: brake, climb to the altitude if it is lower, home, hover."""
    climb = _return_climb(start, altitude_m)
    braking = brake(start, Velocity(velocity.east_m_s, velocity.north_m_s))
    if braking:
        ground, up = Motion(0.0, braking, braking[-1].end), Motion(0.0, climb, climb[-1].end)
        stopping: tuple[MotionPart, ...] = (CombinedMotion(ground, up),)
    else:
        stopping = climb
    above = stopping[-1].end
    return *stopping, *_way_from_above(above, home, ground_speed_m_s=ground_speed_m_s, climbed=len(climb) > 1)


def landing(start: Position) -> tuple[Phase, ...]:
    """The motion of a descent to the ground, slow on the last metres."""
    low = Position(start.east_m, start.north_m, min(start.altitude_m, _SLOWLY_BELOW_M))
    ground = Position(start.east_m, start.north_m)
    return (
        pause(start, _DESCENT_REACTION_S),
        *leg(start, low, cruise_m_s=_DESCENT_M_S, acceleration_m_s2=_DESCENT_M_S2),
        *steadily(low, ground, duration_s=low.altitude_m / _LANDING_M_S),
    )


def _return_climb(start: Position, altitude_m: float) -> tuple[Phase, ...]:
    """The climb to the altitude of returns; if the vehicle is that high already, only the time to turn for home."""
    if start.altitude_m >= altitude_m:
        return (pause(start, _RETURN_REACTION_S),)
    top = Position(start.east_m, start.north_m, altitude_m)
    climb = ramped_leg(start, top, cruise_m_s=_CLIMB_M_S, faster=_RETURN_CLIMBING, slower=_RETURN_LEVELLING)
    return (pause(start, _RETURN_CLIMB_REACTION_S), *climb)


def _way_from_above(
    above: Position, home: Position, *, ground_speed_m_s: float, climbed: bool
) -> tuple[Phase, ...]:
    """The way home at one altitude, and the hover above home.

    After a climb the hover is shorter, because the vehicle leaves before it is at the top.
    """
    above_home = Position(home.east_m, home.north_m, above.altitude_m)
    way = ramped_leg(
        above, above_home, cruise_m_s=ground_speed_m_s, faster=_RETURN_FASTER, slower=_RETURN_SLOWER
    )
    early_s = min(_LEAVES_EARLY_S, duration_s(way)) if climbed else 0.0
    return *way, pause(above_home, _HOVER_S - early_s)


@lru_cache(maxsize=4096)
def _chased(length_m: float, cruise_m_s: float) -> tuple[tuple[float, float, float, float], ...]:
    """A leg from rest in parts: length, speeds at both ends (below 0 on the way back) and seconds of each."""
    return _parts(_GUIDED.chase(length_m, 0j, cruise_m_s=cruise_m_s))


@lru_cache(maxsize=256)
def _held(speed_m_s: float) -> tuple[tuple[float, float, float, float], ...]:
    """The same of a hold at that speed."""
    length_m = _REACTION_S * speed_m_s + speed_m_s**2 / (2 * _STOPS_M_S2)
    return _parts(_GUIDED.chase(length_m, complex(speed_m_s), cruise_m_s=speed_m_s))


def _parts(samples: Iterator[PursuitSample]) -> tuple[tuple[float, float, float, float], ...]:
    knots = _thinned(_turning(list(samples)))
    return tuple(
        (
            after.place_m.real - before.place_m.real,
            before.velocity_m_s.real,
            after.velocity_m_s.real,
            after.elapsed_s - before.elapsed_s,
        )
        for before, after in itertools.pairwise(knots)
    )


def _turning(samples: list[PursuitSample]) -> list[PursuitSample]:
    """The samples of a straight way, with a sample at rest where it turns back, as a phase has one direction."""
    for number, (before, after) in enumerate(itertools.pairwise(samples)):
        if before.velocity_m_s.real * after.velocity_m_s.real < 0:
            turns = min((number, number + 1), key=lambda index: abs(samples[index].velocity_m_s))
            samples[turns] = PursuitSample(samples[turns].elapsed_s, samples[turns].place_m, 0j)
    return samples


def _thinned(samples: Sequence[PursuitSample]) -> list[PursuitSample]:
    """The first and last sample, and the fewest between from which the others can be interpolated."""
    return [samples[number] for number in _knots(samples)]


def _knots(samples: Sequence[PursuitSample]) -> Iterator[int]:
    begin, last = 0, len(samples) - 1
    rests = [number for number, sample in enumerate(samples) if not sample.velocity_m_s]
    yield begin
    while begin < last:
        end = begin + 1
        for longer in range(begin + _KNOT_SAMPLES, min(begin + _LONGEST_SAMPLES, last) + 1, _KNOT_SAMPLES):
            if any(begin < rest < longer for rest in rests) or not _drawn_well(samples, begin, longer):
                break
            end = longer
        yield end
        begin = end


def _drawn_well(samples: Sequence[PursuitSample], begin: int, end: int) -> bool:
    """Whether one curve between two samples is near enough to the samples between them, where none rests."""
    before, after = samples[begin], samples[end]
    lasts_s = after.elapsed_s - before.elapsed_s
    mean_m_s = (after.place_m - before.place_m) / lasts_s
    for sample in samples[begin + 1 : end : 2]:
        share = (sample.elapsed_s - before.elapsed_s) / lasts_s
        rest = 1 - share
        drawn_m_s = (
            6 * share * rest * mean_m_s
            + rest * (1 - 3 * share) * before.velocity_m_s
            + share * (3 * share - 2) * after.velocity_m_s
        )
        if abs(drawn_m_s - sample.velocity_m_s) > _KNOT_M_S:
            return False
    return True


def _between(start: Position, end: Position) -> Velocity:
    """The way from one place to the other, as a vector in metres."""
    return Velocity(end.east_m - start.east_m, end.north_m - start.north_m, end.altitude_m - start.altitude_m)


def _product(one: Velocity, other: Velocity) -> float:
    return one.east_m_s * other.east_m_s + one.north_m_s * other.north_m_s + one.up_m_s * other.up_m_s


def _vector(ahead: Velocity, aside: Velocity, number: complex) -> Velocity:
    """The vector of the complex number: its real part along `ahead`, its imaginary part along `aside`."""
    return Velocity(
        number.real * ahead.east_m_s + number.imag * aside.east_m_s,
        number.real * ahead.north_m_s + number.imag * aside.north_m_s,
        number.real * ahead.up_m_s + number.imag * aside.up_m_s,
    )


def _place(start: Position, ahead: Velocity, aside: Velocity, number: complex) -> Position:
    offset = _vector(ahead, aside, number)
    return Position(
        start.east_m + offset.east_m_s, start.north_m + offset.north_m_s, start.altitude_m + offset.up_m_s
    )


def _cruise_m_s(start: Position, end: Position, ground_speed_m_s: float) -> float:
    return cruise_m_s(start, end, ground_speed_m_s, climb_m_s=_CLIMB_M_S, descent_m_s=_DESCENT_M_S)
