"""The course of a vehicle that follows setpoints: a point that moves as the vehicle can.

Setpoints that jump to a target a leg away are flown to with all the speed that the vehicle allows itself, and
overshot. A point that speeds up, cruises and brakes on the way there keeps the speed of the leg, and a stop is its
own stopping place: the vehicle never flies back to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Position, Velocity, ahead, distance_m

_AT_TARGET_M = 0.1
_CLOSES_IN_PER_S = 0.7  # of what is left, at the end: so that what held the vehicle against the air can fade
_AT_REST_M_S = 0.05
_LAG_ALLOWED_M = 3.0  # behind the point, beyond which it waits for the vehicle
_CATCHES_UP = 2.0  # times the acceleration, so that the point keeps to its own braking curve
_USED = 0.4  # of the acceleration: the vehicle is to follow in wind, too


@dataclass(frozen=True, slots=True)
class Abilities:
    """What the vehicle allows itself."""

    ground_speed_m_s: float = 12.0
    climb_m_s: float = 3.0
    descent_m_s: float = 1.5
    acceleration_m_s2: float = 3.0


class Course:
    """A point with a velocity that goes to its target, or brakes where it has none."""

    def __init__(self, position: Position, velocity: Velocity, abilities: Abilities) -> None:
        self.position = position
        self.velocity = velocity
        self.setpoint_velocity = Velocity()  # none while it waits: the vehicle would fly past it
        self.setpoint_acceleration = Velocity()  # the change of that in a second
        self._abilities = abilities
        self._acceleration_m_s2 = abilities.acceleration_m_s2 * _USED
        self._target: Position | None = None
        self._ground_speed_m_s = 0.0

    def aim(self, target: Position, *, ground_speed_m_s: float) -> None:
        """It goes there from now on."""
        self._target = target
        self._ground_speed_m_s = min(ground_speed_m_s, self._abilities.ground_speed_m_s)

    def stop(self) -> None:
        """It brakes from now on, and stays where it comes to rest."""
        self._target = None

    @property
    def stopping_place(self) -> Position:
        """Where it would come to rest if it braked now."""
        return ahead(self.position, self.velocity, self.velocity.speed_m_s / (2 * self._acceleration_m_s2))

    @property
    def ended(self) -> bool:
        """Whether it is at its target, or at rest where it has none."""
        return self._target in (None, self.position) and self.velocity.speed_m_s < _AT_REST_M_S

    def advance(self, passed_s: float, *, vehicle: Position) -> None:
        """Moves on by that time, slower while the vehicle is far away, and not at all while it is farther."""
        share = min(1.0, max(0.0, 2.0 - distance_m(self.position, vehicle) / _LAG_ALLOWED_M))
        self.setpoint_velocity, self.setpoint_acceleration = Velocity(), Velocity()
        if share > 0 and passed_s > 0:
            self._move(passed_s * share)
            self.setpoint_velocity = _times(self.velocity, share)

    def _move(self, step_s: float) -> None:
        wanted, change_m_s2 = self._wanted(step_s)
        before, self.velocity = self.velocity, _towards(self.velocity, wanted, change_m_s2 * step_s)
        self.setpoint_acceleration = _times(_difference(self.velocity, before), 1 / step_s)
        here, flies = self.position, self.velocity
        moved = Position(
            here.east_m + flies.east_m_s * step_s,
            here.north_m + flies.north_m_s * step_s,
            here.altitude_m + flies.up_m_s * step_s,
        )
        target = self._target
        if target is not None and distance_m(moved, target) < _AT_TARGET_M + flies.speed_m_s * step_s / 2:
            moved, self.velocity, self.setpoint_acceleration = target, Velocity(), Velocity()
        self.position = moved

    def _wanted(self, step_s: float) -> tuple[Velocity, float]:
        """The velocity that it should have, and how fast it may come to that."""
        if self._target is None:
            return Velocity(), self._acceleration_m_s2
        left_m = distance_m(self.position, self._target)
        if left_m < _AT_TARGET_M:
            return Velocity(), self._acceleration_m_s2 * _CATCHES_UP
        east, north, up = _direction(self.position, self._target, left_m)
        may_still_stop_m_s = math.sqrt(2 * self._acceleration_m_s2 * left_m)
        gently_m_s = left_m * _CLOSES_IN_PER_S
        speed_m_s = min(self._cruise_m_s(east, north, up), may_still_stop_m_s, gently_m_s, left_m / step_s)
        slows = speed_m_s < self.velocity.speed_m_s
        change_m_s2 = self._acceleration_m_s2 * (_CATCHES_UP if slows else 1.0)
        return Velocity(east * speed_m_s, north * speed_m_s, up * speed_m_s), change_m_s2

    def _cruise_m_s(self, east: float, north: float, up: float) -> float:
        """How fast it may go in that direction."""
        limits = self._abilities
        over_ground = math.hypot(east, north)
        level_m_s = self._ground_speed_m_s / over_ground if over_ground else math.inf
        vertical_m_s = (limits.climb_m_s if up > 0 else limits.descent_m_s) / abs(up) if up else math.inf
        return min(level_m_s, vertical_m_s)


def _direction(start: Position, end: Position, distance_m: float) -> tuple[float, float, float]:
    return (
        (end.east_m - start.east_m) / distance_m,
        (end.north_m - start.north_m) / distance_m,
        (end.altitude_m - start.altitude_m) / distance_m,
    )


def _times(velocity: Velocity, factor: float) -> Velocity:
    return Velocity(velocity.east_m_s * factor, velocity.north_m_s * factor, velocity.up_m_s * factor)


def _difference(after: Velocity, before: Velocity) -> Velocity:
    return Velocity(
        after.east_m_s - before.east_m_s, after.north_m_s - before.north_m_s, after.up_m_s - before.up_m_s
    )


def _towards(velocity: Velocity, wanted: Velocity, change_m_s: float) -> Velocity:
    """The velocity changed towards the wanted one by so much at most."""
    missing = _difference(wanted, velocity)
    if missing.speed_m_s <= change_m_s:
        return wanted
    part = _times(missing, change_m_s / missing.speed_m_s)
    return Velocity(
        velocity.east_m_s + part.east_m_s, velocity.north_m_s + part.north_m_s, velocity.up_m_s + part.up_m_s
    )
