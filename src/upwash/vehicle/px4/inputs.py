"""What reaches a stand-in PX4 while it flies: a pilot's sticks, setpoints, and signs of life; and its GPS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from upwash.core.geo import Velocity
from upwash.vehicle.body.parameters import ParameterTable

THROTTLE_MIDDLE = 500
_DEADZONE = 0.1
_HEARTBEATS_LATE_S = 1.9  # that long after COM_DL_LOSS_T, or COM_OBC_LOSS_T, a peer counts as lost
_COMPANION_LATE_S = 1.5
_FEWEST_SATELLITES = 4
_FIX_SETTLES_S = 2.2  # after GPS has come back, until it knows where it is
_BLIND_AFTER_S = 5.0  # without GPS, until it no longer does


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a companion streams in OFFBOARD: a place, a velocity, or one of them over the ground and one up."""

    east_north_m: tuple[float, float] | None = None
    altitude_m: float | None = None
    velocity: Velocity | None = None
    yaw_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Sticks:
    """Where a pilot's sticks are: shares of what they can, and the throttle from 0 to 1000."""

    forward: float = 0.0
    right: float = 0.0
    turn: float = 0.0
    throttle: float = THROTTLE_MIDDLE

    def moved(self, threshold: float = _DEADZONE) -> bool:
        """Whether somebody has hold of them."""
        return max(abs(self.forward), abs(self.right), abs(self.turn)) > threshold


def past_deadzone(share: float) -> float:
    """How far a stick is beyond where it may rest, as a share of what is left."""
    if abs(share) <= _DEADZONE:
        return 0.0
    return math.copysign(min(1.0, (abs(share) - _DEADZONE) / (1 - _DEADZONE)), share)


class Px4Inputs:
    """Who is heard, and since when no more: a pilot's sticks, a ground station, a companion and its setpoints."""

    def __init__(self, parameters: ParameterTable) -> None:
        self.sticks = Sticks()
        self.sticks_at_arming = self.ground_station_at_arming = False
        self._parameters = parameters
        self._sticks_s = self._ground_station_s = self._companion_s = self._setpoint_s = -math.inf
        self._sticks_known = self._ground_station_known = self._companion_known = False

    def hears_sticks(self, now_s: float) -> bool:
        """Whether a pilot's sticks are heard."""
        return now_s - self._sticks_s <= self._parameters["COM_RC_LOSS_T"]

    def hears_ground_station(self, now_s: float) -> bool:
        """Whether a ground station is heard."""
        return now_s - self._ground_station_s <= self._parameters["COM_DL_LOSS_T"] + _HEARTBEATS_LATE_S

    def hears_companion(self, now_s: float) -> bool:
        """Whether a companion computer is heard."""
        return now_s - self._companion_s <= self._parameters["COM_OBC_LOSS_T"] + _COMPANION_LATE_S

    def hears_setpoints(self, now_s: float) -> bool:
        """Whether setpoints for OFFBOARD are heard."""
        return now_s - self._setpoint_s <= self._parameters["COM_OF_LOSS_T"]

    def take_sticks(self, sticks: Sticks, now_s: float) -> None:
        """A pilot's sticks are there."""
        self.sticks, self._sticks_s, self._sticks_known = sticks, now_s, True

    def take_setpoint(self, now_s: float) -> None:
        """A setpoint has come."""
        self._setpoint_s = now_s

    def take_ground_station(self, now_s: float) -> bool:
        """A ground station is alive; whether it had been lost."""
        regained = self._ground_station_known and not self.hears_ground_station(now_s)
        self._ground_station_s, self._ground_station_known = now_s, True
        return regained

    def take_companion(self, now_s: float) -> bool:
        """A companion computer is alive; whether it had been lost."""
        regained = self._companion_known and not self.hears_companion(now_s)
        self._companion_s, self._companion_known = now_s, True
        return regained

    def arm(self, now_s: float) -> None:
        """Those who are heard at arming are missed later on."""
        self.sticks_at_arming = self.hears_sticks(now_s)
        self.ground_station_at_arming = self.hears_ground_station(now_s)

    def lost(self, before_s: float, now_s: float) -> Iterator[str]:
        """The events that tell who was still heard before, and is no more."""
        if self._companion_known and self.hears_companion(before_s) > self.hears_companion(now_s):
            yield "commander_mission_comp_lost"
        if self._ground_station_known and self.hears_ground_station(before_s) > self.hears_ground_station(
            now_s
        ):
            yield "commander_gcs_lost"
        if self._sticks_known and self.hears_sticks(before_s) > self.hears_sticks(now_s):
            yield "commander_rc_lost"


class Gps:
    """Its receiver, and what it knows by it of where it is."""

    def __init__(self, *, booted_s: float, settles_s: float) -> None:
        self.has_fix = False
        self.placed = False  # it knows where it is
        self._booted_s = booted_s
        self._settles_s = settles_s
        self._fix_s: float | None = None  # since when it has one, or has lost it

    @property
    def ever_had_fix(self) -> bool:
        """Whether it ever told where it is."""
        return self._fix_s is not None

    def look(self, satellites: float, now_s: float) -> None:
        """Takes in how many satellites there are now."""
        has_fix = satellites >= _FEWEST_SATELLITES
        first = self._fix_s is None
        if has_fix != self.has_fix:
            self.has_fix, self._fix_s = has_fix, now_s
            if has_fix and first:
                self._fix_s = self._booted_s
        if self._fix_s is None:
            return
        if has_fix and not self.placed:
            settles_s = self._settles_s if self._fix_s == self._booted_s else _FIX_SETTLES_S
            self.placed = now_s >= self._fix_s + settles_s
        elif not has_fix and self.placed:
            self.placed = now_s < self._fix_s + _BLIND_AFTER_S
