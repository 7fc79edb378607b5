"""When a stand-in PX4 leaves the ground, believes to be back on it, and stops its motors there."""

from __future__ import annotations

from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.airframe import BELIEVES_GROUND_S, spool_up_s
from upwash.vehicle.px4.body import STEP_S, Body
from upwash.vehicle.px4.events import Tell

DISARMED_BY_COMMAND, _DISARMED_BY_LANDING, _DISARMED_BEFORE_FLIGHT = 4, 6, 7
_DISARMS_LATE_S = 1.0  # after COM_DISARM_PRFLT
_TAKEOFF_SEEN_S, _TAKEOFF_SHOWN_S = 1.0, 1.2  # after the command, long before it lifts
_TOUCHING_M = 0.02


class Ground:
    """Whether it stands on the ground, and for how long its motors run there."""

    def __init__(self, body: Body, parameters: ParameterTable, tell: Tell) -> None:
        self.grounded = True
        self.falls = False  # without its motors
        self._body = body
        self._parameters = parameters
        self._tell = tell
        self._flew = False  # since it was armed
        self._lifting_s: float | None = None  # since when
        self._touched_s: float | None = None
        self._disarms_s: float | None = None

    @property
    def lifting(self) -> bool:
        """Whether it spools up to take off."""
        return self._lifting_s is not None

    def shows_takeoff(self, now_s: float) -> bool:
        """Whether it reports a take-off, still on the ground."""
        return self._lifting_s is not None and now_s >= self._lifting_s + _TAKEOFF_SHOWN_S

    def arm(self) -> None:
        """Its motors have started."""
        self._flew, self._disarms_s, self._lifting_s = False, None, None

    def disarm(self) -> None:
        """Its motors have stopped."""
        self._disarms_s = self._lifting_s = None

    def lift(self, now_s: float) -> None:
        """Begins to spool up, if it stands."""
        if self.grounded and self._lifting_s is None:
            self._lifting_s = now_s
            self._disarms_s = None

    def stay(self) -> None:
        """Gives up a take-off that has not left the ground."""
        self._lifting_s = None

    def spool_up(self, now_s: float) -> bool:
        """Goes on for a step; whether it lifts off in it."""
        if self._lifting_s is None:
            return False
        since_s = now_s - self._lifting_s
        if since_s - STEP_S < _TAKEOFF_SEEN_S <= since_s:
            self._tell("commander_takeoff_detected")
        if since_s < spool_up_s:
            return False
        self.grounded, self._flew, self._lifting_s = False, True, None
        return True

    def why_disarm(self, now_s: float, armed_s: float) -> int | None:
        """Why its motors are to stop now, armed since then on the ground: a reason by PX4's numbers."""
        if self._disarms_s is not None and now_s >= self._disarms_s:
            return _DISARMED_BY_LANDING
        before_flight_s = self._parameters["COM_DISARM_PRFLT"]
        waits = not self._flew and self._lifting_s is None and before_flight_s > 0
        late = now_s >= armed_s + before_flight_s + _DISARMS_LATE_S
        return _DISARMED_BEFORE_FLIGHT if waits and late else None

    def look_for_it(self, now_s: float, *, armed: bool) -> None:
        """Takes note of a touch, and believes it after a while."""
        if self.grounded:
            return
        touches = self._body.altitude_m <= _TOUCHING_M and self._body.up_m_s <= 0
        if not touches:
            self._touched_s = None
            return
        if self._touched_s is None:
            self._touched_s = now_s
        if self.falls or now_s >= self._touched_s + BELIEVES_GROUND_S:
            self.grounded, self.falls, self._touched_s = True, False, None
            self._tell("commander_landing_detected")
            delay_s = self._parameters["COM_DISARM_LAND"]
            self._disarms_s = now_s + delay_s if armed and delay_s > 0 else None
