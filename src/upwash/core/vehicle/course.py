"""The course of a PX4 in OFFBOARD: a moving point on the way to the target, which the vehicle follows.

A vehicle flies to a setpoint a leg away at full speed, and overshoots. A point that accelerates, cruises and brakes
keeps the speed of the leg. To stop, the point brakes ahead of the vehicle, so that the vehicle never flies back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Position, Velocity, ahead, distance_m

_AT_TARGET_M = 0.1
_CLOSES_IN_PER_S = 0.7  # of the rest of the way, at its end: what held the vehicle against the air can fade
_AT_REST_M_S = 0.05
_LAG_ALLOWED_M = 3.0  # behind the point; beyond it, or beyond as many seconds of flight, the point waits
_LAG_ALLOWED_S = 0.6  # a PX4 is 0.4 s behind without wind
_CATCHES_UP = 2.0  # times the acceleration, so that the point keeps to its own braking curve
_USED = 0.4  # of the acceleration, as a reserve for wind


@dataclass(frozen=True, slots=True)
class Abilities:
    """The vehicle's greatest speeds and acceleration."""

    ground_speed_m_s: float = 12.0
    climb_m_s: float = 3.0
    descent_m_s: float = 1.5
    acceleration_m_s2: float = 3.0


class SetpointCourse:
    """A moving point that goes to its target, or brakes without one."""

    def __init__(self, position: Position, velocity: Velocity, abilities: Abilities) -> None:
        self.position = position
        self.velocity = velocity
        self.setpoint_velocity = Velocity()  # none while it waits: the vehicle would fly past it
        self.setpoint_acceleration = Velocity()  # its change in a second
        self._abilities = abilities
        self._acceleration_m_s2 = abilities.acceleration_m_s2 * _USED
        self._target: Position | None = None
        self._ground_speed_m_s = 0.0

    def aim(self, target: Position, *, ground_speed_m_s: float) -> None:
        """Let the point go to `target` from now on."""
        self._target = target
        self._ground_speed_m_s = min(ground_speed_m_s, self._abilities.ground_speed_m_s)

    def stop(self) -> None:
        """Let the point brake from now on, and stay where it comes to rest."""
        self._target = None

    @property
    def stopping_place(self) -> Position:
        """The position where the point would come to rest if it braked now."""
        return ahead(self.position, self.velocity, self.velocity.speed_m_s / (2 * self._acceleration_m_s2))

    @property
    def ended(self) -> bool:
        """Whether the point rests at its target, or anywhere without one."""
        return self._target in (None, self.position) and self.velocity.speed_m_s < _AT_REST_M_S

    def advance(self, passed_s: float, *, vehicle: Position) -> None:
        """Move the point on by `passed_s`, more slowly the farther the vehicle is behind, and finally not at all."""
        allowed_m = max(_LAG_ALLOWED_M, _LAG_ALLOWED_S * self.velocity.speed_m_s)
        share = min(1.0, max(0.0, 2.0 - distance_m(self.position, vehicle) / allowed_m))
        self.setpoint_velocity, self.setpoint_acceleration = Velocity(), Velocity()
        if share > 0 and passed_s > 0:
            self._move(passed_s * share)
            self.setpoint_velocity = _times(self.velocity, share)

    def _move(self, step_s: float) -> None:
        wanted, change_m_s2 = self._wanted(step_s)
        before, most_m_s = self.velocity, change_m_s2 * step_s
        missing = _sum(wanted, _times(before, -1))
        self.velocity = wanted
        if missing.speed_m_s > most_m_s:
            self.velocity = _sum(before, _times(missing, most_m_s / missing.speed_m_s))
        self.setpoint_acceleration = _times(_sum(self.velocity, _times(before, -1)), 1 / step_s)
        here, flies, target = self.position, self.velocity, self._target
        moved = Position(
            here.east_m + flies.east_m_s * step_s,
            here.north_m + flies.north_m_s * step_s,
            here.altitude_m + flies.up_m_s * step_s,
        )
        if target is not None and distance_m(moved, target) < _AT_TARGET_M + flies.speed_m_s * step_s / 2:
            moved, self.velocity, self.setpoint_acceleration = target, Velocity(), Velocity()
        self.position = moved

    def _wanted(self, step_s: float) -> tuple[Velocity, float]:
        """The velocity that the point should have, and the largest change towards it in a second."""
        if self._target is None:
            return Velocity(), self._acceleration_m_s2
        here, target, left_m = self.position, self._target, distance_m(self.position, self._target)
        if left_m < _AT_TARGET_M:
            return Velocity(), self._acceleration_m_s2 * _CATCHES_UP
        east, north = (target.east_m - here.east_m) / left_m, (target.north_m - here.north_m) / left_m
        up = (target.altitude_m - here.altitude_m) / left_m
        may_still_stop_m_s = math.sqrt(2 * self._acceleration_m_s2 * left_m)
        gently_m_s = left_m * _CLOSES_IN_PER_S
        speed_m_s = min(self._cruise_m_s(east, north, up), may_still_stop_m_s, gently_m_s, left_m / step_s)
        slows = speed_m_s < self.velocity.speed_m_s
        change_m_s2 = self._acceleration_m_s2 * (_CATCHES_UP if slows else 1.0)
        return Velocity(east * speed_m_s, north * speed_m_s, up * speed_m_s), change_m_s2

    def _cruise_m_s(self, east: float, north: float, up: float) -> float:
        limits = self._abilities
        over_ground = math.hypot(east, north)
        level_m_s = self._ground_speed_m_s / over_ground if over_ground else math.inf
        vertical_m_s = (limits.climb_m_s if up > 0 else limits.descent_m_s) / abs(up) if up else math.inf
        return min(level_m_s, vertical_m_s)


def _times(velocity: Velocity, factor: float) -> Velocity:
    return Velocity(velocity.east_m_s * factor, velocity.north_m_s * factor, velocity.up_m_s * factor)


def _sum(a: Velocity, b: Velocity) -> Velocity:
    return Velocity(a.east_m_s + b.east_m_s, a.north_m_s + b.north_m_s, a.up_m_s + b.up_m_s)
