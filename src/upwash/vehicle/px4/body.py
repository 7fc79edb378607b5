"""A PX4's body and the controllers that move it, step by step.

It is a point under drag whose speed is held by proportion and integral. That is why it first stays below the wanted
speed, creeps up to it, and overshoots where it stops: the integral, which holds against the drag, is left over. The
constants are fitted to the medians of eleven recorded legs in each of four ways of flying (version 1.16.1,
quadrotor, in its own simulation, no wind).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Position, Velocity

STEP_S = 0.05

_PROPORTION, _INTEGRAL, _DRAG = 1.06, 0.345, 0.612  # of speed: 1/s, 1/s², 1/s
_TILT_M_S2, _TILT_LAG_S = 7.83, 0.05
_SPEEDING_UP_M_S2 = 3.29
_STOPPING_M_S2 = 3.4  # at the command to hold
_BRAKING_M_S2, _BRAKING_LEAD_S = 2.66, 2.34  # on the way to a place: speed²/2a + lead x speed is what is left
_STIFFNESS_1_S = 0.767  # of OFFBOARD: speed per metre that is left
_EASING_S = 0.4  # of a pilot's sticks

CLIMB_M_S, CLIMB_RETURNING_M_S = 1.32, 2.85  # at take-off, and to the altitude of a return
CLIMBING_M_S2, _VERTICAL_M_S2 = 0.75, 2.5
_VERTICAL_1_S = 0.65
SINKING_M_S, _SINKING_LOW_M_S = 1.2, 0.7
_SLOWER_BELOW_M, _SLOW_BELOW_M = 10.0, 5.0
BLIND_SINKING_M_S = 0.668  # without a position, or without a pilot

_TURNING_DEG_S = 40.0


@dataclass(frozen=True, slots=True)
class Steering:
    """The aim of the body: a place, a velocity or a stop; and beside that an altitude.

    A `place` is flown to at most at `cap_m_s`: `stiffly` as in OFFBOARD, else as in AUTO. Without a place the body
    takes up the velocity, and `eases` into it under a pilot's sticks; without either it brakes, and not
    even that if it is `level`.
    """

    place: Position | None = None
    cap_m_s: float = 0.0
    stiffly: bool = False
    velocity: Velocity | None = None
    eases: bool = False
    level: bool = False
    altitude_m: float | None = None
    climb_m_s: float = CLIMB_RETURNING_M_S
    sink_m_s: float = SINKING_M_S
    climb_m_s2: float = _VERTICAL_M_S2
    turns_to_deg: float | None = None


@dataclass(slots=True)
class Body:
    """The vehicle as a point, with what its controllers remember."""

    place_m: complex = 0j  # east, and north as the imaginary part, as in the velocities
    altitude_m: float = 0.0
    ground_m_s: complex = 0j
    up_m_s: float = 0.0
    heading_deg: float = 0.0
    _held: complex = 0j  # the integrals
    _thrust: complex = 0j
    _told: complex = 0j  # the ramp of AUTO

    @property
    def position(self) -> Position:
        """The place after its last step."""
        return Position(self.place_m.real, self.place_m.imag, self.altitude_m)

    def ahead(self, since_s: float) -> Position:
        """The place at that time after its last step."""
        place_m = self.place_m + self.ground_m_s * since_s
        return Position(place_m.real, place_m.imag, max(0.0, self.altitude_m + self.up_m_s * since_s))

    @property
    def velocity(self) -> Velocity:
        """The velocity after its last step."""
        return Velocity(self.ground_m_s.real, self.ground_m_s.imag, self.up_m_s)

    @property
    def told_to_stand(self) -> bool:
        """Whether the controllers demand no speed any more; the body may still overshoot."""
        return self._told == 0

    def rest(self) -> None:
        """Stops the body and its controllers, as on the ground."""
        self.ground_m_s, self.up_m_s = 0j, 0.0
        self._held = self._thrust = self._told = 0j

    def cruise(self, east_m_s: float) -> None:
        """Sets the body to a steady speed east, with controllers that have settled at it."""
        self.ground_m_s = self._told = complex(east_m_s)
        self._held = self._thrust = _DRAG * self.ground_m_s

    def step(self, steering: Steering) -> None:
        """Moves the body by one step of `STEP_S`."""
        self._move_over_ground(steering)
        self._move_vertically(steering)
        self._turn(steering)

    def _move_over_ground(self, steering: Steering) -> None:
        if steering.level:
            thrust, self._told = 0j, self.ground_m_s
        else:
            thrust = self._wanted_thrust(self._wanted(steering))
        self._thrust += (thrust - self._thrust) * (STEP_S / _TILT_LAG_S)
        self.ground_m_s += (self._thrust - _DRAG * self.ground_m_s) * STEP_S
        self.place_m += self.ground_m_s * STEP_S

    def _wanted(self, steering: Steering) -> complex:
        """The velocity that the controllers aim at."""
        velocity_m_s = 0j
        if steering.velocity is not None:
            velocity_m_s = complex(steering.velocity.east_m_s, steering.velocity.north_m_s)
        if steering.velocity is not None and steering.place is None:
            self._told += (velocity_m_s - self._told) * (STEP_S / _EASING_S if steering.eases else 1.0)
            return self._told
        if steering.place is None:
            return self._ramped(0j, _STOPPING_M_S2)
        way_m = complex(steering.place.east_m, steering.place.north_m) - self.place_m
        left_m = _length(way_m)
        speed_m_s = _STIFFNESS_1_S * left_m if steering.stiffly else _approach_m_s(left_m)
        wanted_m_s = way_m * (min(steering.cap_m_s, speed_m_s) / left_m if left_m else 0.0)
        if steering.stiffly:
            self._told = self.ground_m_s
            return wanted_m_s + velocity_m_s
        return self._ramped(wanted_m_s, _SPEEDING_UP_M_S2)

    def _ramped(self, wanted_m_s: complex, limit_m_s2: float) -> complex:
        more_m_s = wanted_m_s - self._told
        size_m_s = _length(more_m_s)
        self._told += more_m_s * (min(1.0, limit_m_s2 * STEP_S / size_m_s) if size_m_s else 0.0)
        return self._told

    def _wanted_thrust(self, wanted_m_s: complex) -> complex:
        lacks_m_s = wanted_m_s - self.ground_m_s
        thrust = _PROPORTION * lacks_m_s + self._held
        strength = _length(thrust)
        if strength <= _TILT_M_S2 or lacks_m_s.real * thrust.real + lacks_m_s.imag * thrust.imag < 0:
            self._held += _INTEGRAL * lacks_m_s * STEP_S
        return thrust * (min(1.0, _TILT_M_S2 / strength) if strength else 0.0)

    def _move_vertically(self, steering: Steering) -> None:
        wanted_m_s = 0.0
        if steering.altitude_m is not None:
            left_m = steering.altitude_m - self.altitude_m
            wanted_m_s = max(-steering.sink_m_s, min(steering.climb_m_s, _VERTICAL_1_S * left_m))
        elif steering.velocity is not None:
            wanted_m_s = steering.velocity.up_m_s
        most = (steering.climb_m_s2 if wanted_m_s > self.up_m_s >= 0 else _VERTICAL_M_S2) * STEP_S
        self.up_m_s += max(-most, min(most, wanted_m_s - self.up_m_s))
        self.altitude_m += self.up_m_s * STEP_S

    def _turn(self, steering: Steering) -> None:
        if steering.turns_to_deg is not None:
            left_deg = math.remainder(steering.turns_to_deg - self.heading_deg, 360)
            most_deg = _TURNING_DEG_S * STEP_S
            self.heading_deg = (self.heading_deg + max(-most_deg, min(most_deg, left_deg))) % 360


def landing_sink_m_s(altitude_m: float) -> float:
    """The speed of descent at the altitude, in m/s: lower on the last metres."""
    share = (altitude_m - _SLOW_BELOW_M) / (_SLOWER_BELOW_M - _SLOW_BELOW_M)
    return _SINKING_LOW_M_S + (SINKING_M_S - _SINKING_LOW_M_S) * max(0.0, min(1.0, share))


def _approach_m_s(left_m: float) -> float:
    """The highest speed that still lets it stop at a place `left_m` away."""
    lead = _BRAKING_M_S2 * _BRAKING_LEAD_S
    return math.sqrt(lead**2 + 2 * _BRAKING_M_S2 * left_m) - lead


def _length(vector: complex) -> float:
    return math.hypot(vector.real, vector.imag)
