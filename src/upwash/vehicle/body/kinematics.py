"""How a vehicle moves: straight lines, each under a constant jerk, a constant acceleration or none, and curves.

A motion is continuous in position and in velocity. Time is an argument everywhere.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import msgspec

from upwash.core.geo import Position, Velocity, distance_m

NO_LENGTH_M = 1e-9  # shorter is no way at all: its share of a speed would be nothing
_HALVINGS = 50  # of a searched interval: finer than any float that matters here


class MotionPart(Protocol):
    """A part of a motion."""

    @property
    def duration_s(self) -> float:
        """How long it takes."""

    @property
    def end(self) -> Position:
        """Where it leads."""

    def position(self, elapsed_s: float) -> Position:
        """The place at that time after the start."""

    def velocity(self, elapsed_s: float) -> Velocity:
        """The velocity at that time after the start."""


class Phase(msgspec.Struct, frozen=True):
    """A straight stretch along `heading`, a vector of length 1, from `speed_m_s` on; it never flies backwards.

    `acceleration_m_s2` is the one at its start, which grows by `jerk_m_s3`.
    """

    start: Position
    heading: Velocity
    speed_m_s: float
    acceleration_m_s2: float
    duration_s: float
    jerk_m_s3: float = 0.0

    def travelled_m(self, elapsed_s: float) -> float:
        """The distance flown at that time after the start."""
        gained_m_s = elapsed_s * (self.acceleration_m_s2 / 2 + elapsed_s * self.jerk_m_s3 / 6)
        return elapsed_s * (self.speed_m_s + gained_m_s)

    def position(self, elapsed_s: float) -> Position:
        """The place at that time after the start."""
        travelled_m = self.travelled_m(elapsed_s)
        return Position(
            east_m=self.start.east_m + travelled_m * self.heading.east_m_s,
            north_m=self.start.north_m + travelled_m * self.heading.north_m_s,
            altitude_m=self.start.altitude_m + travelled_m * self.heading.up_m_s,
        )

    def velocity(self, elapsed_s: float) -> Velocity:
        """The velocity at that time after the start."""
        gained_m_s = elapsed_s * (self.acceleration_m_s2 + elapsed_s * self.jerk_m_s3 / 2)
        speed_m_s = self.speed_m_s + gained_m_s
        return Velocity(
            east_m_s=speed_m_s * self.heading.east_m_s,
            north_m_s=speed_m_s * self.heading.north_m_s,
            up_m_s=speed_m_s * self.heading.up_m_s,
        )

    @property
    def end(self) -> Position:
        """Where it leads."""
        return self.position(self.duration_s)


@dataclass(frozen=True, slots=True)
class Curve:
    """A stretch of a given beginning and end, and the velocities there: under a constant jerk, wherever it bends."""

    start: Position
    velocity_at_start: Velocity
    end: Position
    velocity_at_end: Velocity
    duration_s: float

    def position(self, elapsed_s: float) -> Position:
        """The place at that time after the start."""
        share = elapsed_s / self.duration_s
        rest = 1 - share
        from_start, from_end = rest**2 * (1 + 2 * share), share**2 * (1 + 2 * rest)
        leaving_s, arriving_s = share * rest**2 * self.duration_s, -rest * share**2 * self.duration_s
        here, there, left, came = self.start, self.end, self.velocity_at_start, self.velocity_at_end

        def mixed(here_m: float, there_m: float, left_m_s: float, came_m_s: float) -> float:
            return from_start * here_m + from_end * there_m + leaving_s * left_m_s + arriving_s * came_m_s

        return Position(
            mixed(here.east_m, there.east_m, left.east_m_s, came.east_m_s),
            mixed(here.north_m, there.north_m, left.north_m_s, came.north_m_s),
            mixed(here.altitude_m, there.altitude_m, left.up_m_s, came.up_m_s),
        )

    def velocity(self, elapsed_s: float) -> Velocity:
        """The velocity at that time after the start."""
        share = elapsed_s / self.duration_s
        rest = 1 - share
        way_per_s = 6 * share * rest / self.duration_s
        leaving, arriving = rest * (1 - 3 * share), share * (3 * share - 2)
        here, there, left, came = self.start, self.end, self.velocity_at_start, self.velocity_at_end
        return Velocity(
            way_per_s * (there.east_m - here.east_m) + leaving * left.east_m_s + arriving * came.east_m_s,
            way_per_s * (there.north_m - here.north_m) + leaving * left.north_m_s + arriving * came.north_m_s,
            way_per_s * (there.altitude_m - here.altitude_m) + leaving * left.up_m_s + arriving * came.up_m_s,
        )


@dataclass(frozen=True, slots=True)
class CombinedMotion:
    """Two motions from time 0 on at once: one over the ground, one up or down."""

    over_ground: Motion[MotionPart]
    vertical: Motion[MotionPart]

    @property
    def duration_s(self) -> float:
        """How long the longer one takes."""
        return max(self.over_ground.ends_s, self.vertical.ends_s)

    @property
    def end(self) -> Position:
        """Where they lead."""
        return self.position(self.duration_s)

    def position(self, elapsed_s: float) -> Position:
        """The place at that time after the start."""
        place, height = self.over_ground.position(elapsed_s), self.vertical.position(elapsed_s)
        return Position(place.east_m, place.north_m, height.altitude_m)

    def velocity(self, elapsed_s: float) -> Velocity:
        """The velocity at that time after the start."""
        along, up = self.over_ground.velocity(elapsed_s), self.vertical.velocity(elapsed_s)
        return Velocity(along.east_m_s, along.north_m_s, up.up_m_s)


AnyStretch_co = TypeVar("AnyStretch_co", bound=MotionPart, covariant=True)


@dataclass(frozen=True, slots=True)
class Motion(Generic[AnyStretch_co]):
    """Stretches flown one after the other from `begun_s` on, ending at rest."""

    begun_s: float
    phases: tuple[AnyStretch_co, ...]
    end: Position

    @property
    def ends_s(self) -> float:
        """The time at which the vehicle comes to rest."""
        return self.begun_s + duration_s(self.phases)

    def position(self, now_s: float) -> Position:
        """Where the vehicle is; where it rests once the motion is over."""
        current = self._current(now_s)
        return current[0].position(current[1]) if current else self.end

    def velocity(self, now_s: float) -> Velocity:
        """The velocity in m/s; zero once the motion is over."""
        current = self._current(now_s)
        return current[0].velocity(current[1]) if current else Velocity()

    def _current(self, now_s: float) -> tuple[AnyStretch_co, float] | None:
        elapsed_s = max(0.0, now_s - self.begun_s)
        for phase in self.phases:
            if elapsed_s < phase.duration_s:
                return phase, elapsed_s
            elapsed_s -= phase.duration_s
        return None


@dataclass(frozen=True, slots=True)
class LongMotion(Motion[AnyStretch_co]):
    """A motion of thousands of stretches, each with its begin, in seconds from the first one's."""

    begins_s: Sequence[float]

    def _current(self, now_s: float) -> tuple[AnyStretch_co, float] | None:
        elapsed_s = max(0.0, now_s - self.begun_s)
        number = bisect_right(self.begins_s, elapsed_s) - 1
        phase, elapsed_s = self.phases[number], elapsed_s - self.begins_s[number]
        return (phase, elapsed_s) if elapsed_s < phase.duration_s else None


def duration_s(phases: Sequence[MotionPart]) -> float:
    """How long the phases take together."""
    return sum(phase.duration_s for phase in phases)


def leg(
    start: Position, end: Position, *, cruise_m_s: float, acceleration_m_s2: float, speed_m_s: float = 0.0
) -> tuple[Phase, ...]:
    """A straight line to rest, speeding up and braking alike; a short leg never reaches cruise.

    It begins at `speed_m_s`, which must be no faster than cruise and slow enough to stop at the end.
    """
    if not (cruise_m_s > 0 and acceleration_m_s2 > 0):
        raise ValueError(
            f"a leg needs a speed and an acceleration above 0, not {cruise_m_s} m/s and {acceleration_m_s2} m/s²"
        )
    length_m = distance_m(start, end)
    if length_m < NO_LENGTH_M:
        return ()
    heading = heading_of(start, end)
    top_m_s = min(cruise_m_s, math.sqrt(acceleration_m_s2 * length_m + speed_m_s**2 / 2))
    ramps_m = (2 * top_m_s**2 - speed_m_s**2) / (2 * acceleration_m_s2)
    cruise_s = max(0.0, (length_m - ramps_m) / top_m_s)
    faster = Phase(start, heading, speed_m_s, acceleration_m_s2, (top_m_s - speed_m_s) / acceleration_m_s2)
    steady = Phase(faster.end, heading, top_m_s, 0.0, cruise_s)
    slower = Phase(steady.end, heading, top_m_s, -acceleration_m_s2, top_m_s / acceleration_m_s2)
    return faster, steady, slower


def braking(start: Position, velocity: Velocity, *, acceleration_m_s2: float) -> tuple[Phase, ...]:
    """From the velocity to rest, straight ahead."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s == 0:
        return ()
    heading = direction_of(velocity)
    return (Phase(start, heading, speed_m_s, -acceleration_m_s2, speed_m_s / acceleration_m_s2),)


def pause(place: Position, duration_s: float) -> Phase:
    """A stay at one place."""
    return Phase(place, Velocity(), 0.0, 0.0, duration_s)


def along(
    start: Position, ahead: Velocity, stretches: Iterable[tuple[float, float, float, float]]
) -> tuple[Phase, ...]:
    """Phases along a line: of each the length and the speeds at its ends, below 0 on the way back, and its time."""
    back = Velocity(-ahead.east_m_s, -ahead.north_m_s, -ahead.up_m_s)
    phases: list[Phase] = []
    for length_m, from_m_s, to_m_s, lasts_s in stretches:
        heading, sign = (ahead, 1) if length_m > 0 or (length_m == 0 and from_m_s >= 0) else (back, -1)
        begins_m_s, ends_m_s, mean_m_s = sign * from_m_s, sign * to_m_s, sign * length_m / lasts_s
        acceleration_m_s2 = (6 * mean_m_s - 4 * begins_m_s - 2 * ends_m_s) / lasts_s
        jerk_m_s3 = 6 * (begins_m_s + ends_m_s - 2 * mean_m_s) / lasts_s**2
        phases.append(Phase(start, heading, begins_m_s, acceleration_m_s2, lasts_s, jerk_m_s3))
        start = phases[-1].end
    return tuple(phases)


def steadily(start: Position, end: Position, *, duration_s: float) -> tuple[Phase, ...]:
    """A straight line at one speed; a pause where it leads nowhere or takes no time."""
    length_m = distance_m(start, end)
    if length_m < NO_LENGTH_M or duration_s == 0:
        return (pause(end, duration_s),)
    return (Phase(start, heading_of(start, end), length_m / duration_s, 0.0, duration_s),)


def stretched(phases: Iterable[Phase], factor: float) -> tuple[Phase, ...]:
    """The same way, flown in `factor` times the time."""
    if factor == 1:
        return tuple(phases)
    return tuple(
        Phase(
            phase.start,
            phase.heading,
            phase.speed_m_s / factor,
            phase.acceleration_m_s2 / factor**2,
            phase.duration_s * factor,
            phase.jerk_m_s3 / factor**3,
        )
        for phase in phases
    )


def cruise_m_s(
    start: Position, end: Position, ground_speed_m_s: float, *, climb_m_s: float, descent_m_s: float
) -> float:
    """The ground speed, or less where the way is so steep that climb or descent would be too fast."""
    rise_m = end.altitude_m - start.altitude_m
    if rise_m == 0:
        return ground_speed_m_s
    vertical_m_s = climb_m_s if rise_m > 0 else descent_m_s
    return min(ground_speed_m_s, vertical_m_s * distance_m(start, end) / abs(rise_m))


def direction_of(velocity: Velocity) -> Velocity:
    """The velocity at length 1; unchanged at length 0."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s == 0:
        return velocity
    return Velocity(
        east_m_s=velocity.east_m_s / speed_m_s,
        north_m_s=velocity.north_m_s / speed_m_s,
        up_m_s=velocity.up_m_s / speed_m_s,
    )


def heading_of(start: Position, end: Position) -> Velocity:
    """The direction from one place to another, which must not be the same, as a vector of length 1."""
    length_m = distance_m(start, end)
    return Velocity(
        east_m_s=(end.east_m - start.east_m) / length_m,
        north_m_s=(end.north_m - start.north_m) / length_m,
        up_m_s=(end.altitude_m - start.altitude_m) / length_m,
    )


def elapsed_s(phase: Phase, travelled_m: float) -> float | None:
    """Time from the start of a phase at that distance; None if the phase does not reach it."""
    if not 0 <= travelled_m <= phase.travelled_m(phase.duration_s):
        return None
    if phase.jerk_m_s3:
        return last_true(lambda elapsed_s: phase.travelled_m(elapsed_s) <= travelled_m, phase.duration_s)
    under_root = phase.speed_m_s**2 + 2 * phase.acceleration_m_s2 * travelled_m
    divisor = phase.speed_m_s + math.sqrt(max(0.0, under_root))
    return 2 * travelled_m / divisor if divisor > 0 else None


def down_to(phases: Iterable[Phase], altitude_m: float) -> tuple[Phase, ...]:
    """The phases of a descent, ended at the altitude; all of them for 0, the ground."""
    if altitude_m == 0:
        return tuple(phases)
    kept: list[Phase] = []
    for phase in phases:
        if phase.end.altitude_m >= altitude_m:
            kept.append(phase)
            continue

        def is_above(elapsed_s: float, phase: Phase = phase) -> bool:
            return phase.position(elapsed_s).altitude_m >= altitude_m

        kept.append(msgspec.structs.replace(phase, duration_s=last_true(is_above, phase.duration_s)))
        break
    return tuple(kept)


def last_true(true: Callable[[float], bool], end: float) -> float:
    """The last place between 0 and the end where it is true, which it is from 0 on until it no longer is."""
    begin = 0.0
    for _ in range(_HALVINGS):
        middle = (begin + end) / 2
        begin, end = (middle, end) if true(middle) else (begin, middle)
    return begin
