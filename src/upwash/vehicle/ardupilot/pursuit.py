"""How an autopilot chases a point: it draws a smooth way there, and the vehicle follows that way a little late.

The way is drawn under a greatest speed, acceleration and jerk, and slowly towards its end; the vehicle follows by
its error in place and speed, through motors that take time and air that slows it. So it overshoots its target a
little and creeps back. Places in the plane of the motion are complex numbers: the real axis leads to the target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

_STEP_S = 0.04
_MOST_STEPS = 50_000  # no sensible pursuit takes more
_AT_REST_M, _AT_REST_M_S = 0.02, 0.02
_STEADY_M_S, _STEADY_M_S2 = 0.01, 0.005  # for each m/s of speed: near enough to cruise
_SETTLING_S = 0.5  # over the last centimetres
_MARGIN_S = 0.5  # before it brakes


class PursuitSample(NamedTuple):
    """Place and velocity of the vehicle at that time after the start."""

    elapsed_s: float
    place_m: complex
    velocity_m_s: complex


@dataclass(frozen=True, slots=True)
class Pursuit:
    """The gains and limits of one autopilot and its vehicle."""

    acceleration_m_s2: float
    braking_m_s2: float
    jerk_m_s3: float
    place_gain_per_s: float  # of the way: its speed for each metre that is left
    speed_gain_per_s: float
    following_per_s: float  # of the vehicle: its speed for each metre that it is behind
    correcting_per_s: float
    learning_per_s2: float
    motors_s: float
    drag_per_s: float
    foresight: float  # the share of the way's acceleration that it does not wait to be behind for

    def chase(
        self, length_m: float, velocity_m_s: complex, *, cruise_m_s: float, rests_m: complex | None = None
    ) -> Iterator[PursuitSample]:
        """The motion from place 0, at that velocity, to rest at the length, which is the last sample.

        The way begins at the vehicle, or at rest at `rests_m`, the end of a way that the vehicle has followed.
        """
        way_m, way_m_s, way_m_s2 = (0j, velocity_m_s, 0j) if rests_m is None else (rests_m, 0j, 0j)
        place_m, vehicle_m_s = 0j, velocity_m_s
        learned_m_s2 = self.drag_per_s * velocity_m_s
        if rests_m is not None:  # what braked it is left over, and lets it creep back
            learned_m_s2 -= self.correcting_per_s * self.following_per_s * rests_m
        thrust_m_s2 = learned_m_s2
        elapsed_s, steps = 0.0, 0
        yield PursuitSample(elapsed_s, place_m, vehicle_m_s)
        while not _at_rest(length_m - place_m, vehicle_m_s) and steps < _MOST_STEPS:
            steps += 1
            steady_m = 0.0
            if abs(way_m_s - cruise_m_s) <= _STEADY_M_S * cruise_m_s:
                steady_m = self._steady_m(length_m - way_m, way_m_s2, vehicle_m_s, cruise_m_s)
            if steady_m > cruise_m_s * _STEP_S:
                skipped_s = steady_m / abs(way_m_s)
                elapsed_s += skipped_s
                way_m += way_m_s * skipped_s
                place_m += way_m_s * skipped_s
                yield PursuitSample(elapsed_s, place_m, vehicle_m_s)
                continue
            wanted_m_s = _limited(
                _approach(length_m - way_m, self.place_gain_per_s, self.braking_m_s2), cruise_m_s
            )
            wanted_m_s2 = _limited(
                _approach(wanted_m_s - way_m_s, self.speed_gain_per_s, self.jerk_m_s3), self.acceleration_m_s2
            )
            way_m_s2 += _limited(wanted_m_s2 - way_m_s2, self.jerk_m_s3 * _STEP_S)
            way_m += _STEP_S * (way_m_s + way_m_s2 * _STEP_S / 2)
            way_m_s += way_m_s2 * _STEP_S
            behind_m_s = way_m_s + self.following_per_s * (way_m - place_m) - vehicle_m_s
            learned_m_s2 += self.learning_per_s2 * behind_m_s * _STEP_S
            told_m_s2 = self.foresight * way_m_s2 + self.correcting_per_s * behind_m_s + learned_m_s2
            thrust_m_s2 += (told_m_s2 - thrust_m_s2) * min(1.0, _STEP_S / self.motors_s)
            gained_m_s = (thrust_m_s2 - self.drag_per_s * vehicle_m_s) * _STEP_S
            place_m += (vehicle_m_s + gained_m_s / 2) * _STEP_S
            vehicle_m_s += gained_m_s
            elapsed_s += _STEP_S
            yield PursuitSample(elapsed_s, place_m, vehicle_m_s)
        yield PursuitSample(elapsed_s + _SETTLING_S, complex(length_m), 0j)

    def _steady_m(self, left_m: complex, way_m_s2: complex, vehicle_m_s: complex, cruise_m_s: float) -> float:
        """The distance that it flies on unchanged, on a way at cruise; 0 unless it cruises straight to its target."""
        if (
            abs(vehicle_m_s - cruise_m_s) > _STEADY_M_S * cruise_m_s
            or abs(way_m_s2) > _STEADY_M_S2 * cruise_m_s
            or abs(left_m.imag) > _AT_REST_M
        ):
            return 0.0
        stopping_m = cruise_m_s**2 / 2 / self.braking_m_s2 + self.braking_m_s2 / 2 / self.place_gain_per_s**2
        return left_m.real - stopping_m - cruise_m_s * (_MARGIN_S + 2 * _STEP_S)


def _approach(error: complex, gain_per_s: float, most: float) -> complex:
    """The rate that works an error off: proportional near zero, and no more than a steady change allows."""
    size = abs(error)
    near = most / gain_per_s**2
    if size <= near:
        return error * gain_per_s
    return error * (math.sqrt(2 * most * (size - near / 2)) / size)


def _limited(vector: complex, most: float) -> complex:
    size = abs(vector)
    return vector * (most / size) if size > most else vector


def _at_rest(left_m: complex, velocity_m_s: complex) -> bool:
    return abs(left_m) <= _AT_REST_M and abs(velocity_m_s) <= _AT_REST_M_S
