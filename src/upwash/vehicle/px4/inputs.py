"""What reaches a stand-in PX4 while it flies: a pilot's sticks, setpoints, and signs of life; and its GPS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from upwash.core.geo import Velocity
from upwash.vehicle.body.parameters import ParameterTable

THROTTLE_MIDDLE = 500
_DEADZONE = 0.1
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
        """Whether a hand moves them."""
        return max(abs(self.forward), abs(self.right), abs(self.turn)) > threshold


def past_deadzone(share: float) -> float:
    """How far a stick is beyond where it may rest, as a share of what is left."""
    if abs(share) <= _DEADZONE:
        return 0.0
    return math.copysign(min(1.0, (abs(share) - _DEADZONE) / (1 - _DEADZONE)), share)


class InputSource(Enum):
    """A source that PX4 may hear: the parameter that says how long it may be silent, and the time added to that."""

    COMPANION = "COM_OBC_LOSS_T", 1.5
    GROUND_STATION = "COM_DL_LOSS_T", 1.9
    STICKS = "COM_RC_LOSS_T", 0.0
    SETPOINTS = "COM_OF_LOSS_T", 0.0


LOST = {
    InputSource.COMPANION: "commander_mission_comp_lost",
    InputSource.GROUND_STATION: "commander_gcs_lost",
    InputSource.STICKS: "commander_rc_lost",
}
REGAINED = {
    InputSource.COMPANION: "commander_onboard_ctrl_regained",
    InputSource.GROUND_STATION: "commander_dl_regained",
}
"""The events that tell of lost and regained sources."""


class Px4Inputs:
    """The latest sign of life of each source."""

    def __init__(self, parameters: ParameterTable) -> None:
        self.sticks = Sticks()
        self._at_arming: frozenset[InputSource] = frozenset()
        self._parameters = parameters
        self._heard_s = dict.fromkeys(InputSource, -math.inf)

    def hears(self, source: InputSource, now_s: float) -> bool:
        """Whether the source is present."""
        parameter, late_s = source.value
        return now_s - self._heard_s[source] <= self._parameters[parameter] + late_s

    def take(self, source: InputSource, now_s: float) -> bool:
        """Notes a sign of life; whether the source had been lost."""
        regained = self._heard_s[source] > -math.inf and not self.hears(source, now_s)
        self._heard_s[source] = now_s
        return regained

    def arm(self, now_s: float) -> None:
        """Remembers the sources that are present at arming."""
        self._at_arming = frozenset(source for source in InputSource if self.hears(source, now_s))

    def misses(self, source: InputSource, now_s: float) -> bool:
        """Whether the source was present at arming, and no longer is."""
        return source in self._at_arming and not self.hears(source, now_s)

    def lost(self, before_s: float, now_s: float) -> Iterator[str]:
        """The events of the sources that were still heard before, and are no more."""
        for source, event in LOST.items():
            if self.hears(source, before_s) > self.hears(source, now_s):
                yield event


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
