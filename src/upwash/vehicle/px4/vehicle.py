"""The answers and deeds of a stand-in PX4: modes, arming, take-off, repositions, OFFBOARD, fail-safes.

It decides its modes; `Px4Flight` moves it in them. It lives in steps of `STEP_S`: it catches up with the time of
each question, and before each command. Nothing here needs a clock, a socket or a timer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

from upwash.core.geo import Position, Velocity, ground_distance_m
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.copter import HOME, FaultKind, LandedState, Result, is_sensible
from upwash.vehicle.body.fence import UploadedFence
from upwash.vehicle.px4.body import STEP_S
from upwash.vehicle.px4.failsafe import (
    FENCE_ACTIONS,
    LINK_ACTIONS,
    MODES_OF_ACTIONS,
    OFFBOARD_ACTIONS,
    Action,
    Cause,
    Danger,
    Failsafe,
    announce,
)
from upwash.vehicle.px4.flight import DISARMED_BY_COMMAND, MANUAL, Px4Flight
from upwash.vehicle.px4.inputs import REGAINED, Gps, InputSource, Setpoint, Sticks
from upwash.vehicle.px4.navigator import LOWEST_M, Reposition
from upwash.vehicle.px4.settings import Px4Settings

_HOME_MOVES_M = 0.3  # at arming: the height of home was an estimate until then
FORCED = 21196  # PX4's magic number, to arm and to disarm

_AUTO = (Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND)
_BOOT_S, _FIRST_CHECKS_S = 1.0, 2.0
_BLIND_MODES = (Mode.MANUAL, Mode.ALTCTL, Mode.ACRO, Mode.STABILIZED)  # they need no place
_EXCEPTION_BITS = {Mode.MISSION: 1, Mode.LOITER: 2, Mode.OFFBOARD: 4}  # of COM_RCL_EXCEPT
_NOT_TO_ARM_IN = (Mode.RTL, Mode.LAND, Mode.MISSION)


class Quadrotor(Px4Flight):
    """A multicopter between two steps."""

    def __init__(self, settings: Px4Settings, *, now_s: float) -> None:
        super().__init__(settings, now_s=now_s)
        self.fence = UploadedFence()
        self.gps = Gps(booted_s=now_s, settles_s=settings.armable_after_s)
        self.intended = Mode.LOITER
        self._after_disarming = Mode.LOITER
        self._failsafe = Failsafe()
        self._ever_armed = False

    # --- what it reports ------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Simulates the vehicle up to the time, in steps."""
        while self._time_s + STEP_S <= now_s:
            self._time_s += STEP_S
            self._live()

    def position(self, now_s: float) -> Position:
        """The position in m, relative to home."""
        self.advance(now_s)
        return self._body.ahead(min(max(0.0, now_s - self._time_s), STEP_S))

    def velocity(self, now_s: float) -> Velocity:
        """The velocity in m/s."""
        self.advance(now_s)
        return self._body.velocity

    def heading_deg(self, now_s: float) -> float:
        """The heading in degrees clockwise from north."""
        self.advance(now_s)
        return self._body.heading_deg

    def home_altitude_m(self) -> float:
        """The altitude of home above the sea in m, as the vehicle knows it: before the first arming, roughly."""
        return self.settings.home_altitude_m - (0.0 if self._ever_armed else _HOME_MOVES_M)

    def target(self, now_s: float) -> Position | None:
        """The place it flies to by itself or in OFFBOARD, if any."""
        self.advance(now_s)
        if not self.armed or self._grounded:
            return None
        return self._target_in(self.mode)

    def booting(self, now_s: float) -> bool:
        """Whether it does not speak yet."""
        return self.uptime_s(now_s) < min(_BOOT_S, self.settings.armable_after_s)

    def checked(self, now_s: float) -> bool:
        """Whether its first checks have run."""
        return self.uptime_s(now_s) >= min(_FIRST_CHECKS_S, self.settings.armable_after_s)

    def flying(self, now_s: float) -> bool:
        """Whether it is off the ground."""
        self.advance(now_s)
        return not self._grounded

    @property
    def fails_safe(self) -> bool:
        """Whether a fail-safe has it, or will in a moment."""
        return self._failsafe.action is not None

    @property
    def descends_blindly(self) -> bool:
        """Whether it only sinks, without knowing where it is; its mode looks like LAND."""
        return self._failsafe.action is Action.DESCEND

    def unix_s(self, _now_s: float) -> float:
        """The date, once it has had a fix; 0 before."""
        return time.time() if self.gps.ever_had_fix else 0.0

    def has_origin(self, _now_s: float) -> bool:
        """Whether it has an origin to tell positions from: since its first fix."""
        return self.gps.ever_had_fix

    def main_percent(self, now_s: float) -> float:
        """The charge in SYS_STATUS and for its fail-safes: that of the lowest battery."""
        return min(self.batteries_percent(now_s))

    def battery_level(self, now_s: float) -> int:
        """MAV_BATTERY_CHARGE_STATE: 1 well, 2 low, 3 critical, 4 emergency."""
        left = self.main_percent(now_s) / 100
        thresholds = "BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR"
        return 1 + sum(left <= self.parameters[name] for name in thresholds)

    def hears_setpoints(self, now_s: float) -> bool:
        """Whether setpoints for OFFBOARD arrive, and can be followed."""
        return self.inputs.hears(InputSource.SETPOINTS, now_s) and self.gps.placed

    def armable(self, now_s: float) -> bool:
        """Whether its checks would let it be armed now."""
        return (
            self.checked(now_s)
            and self.intended not in _NOT_TO_ARM_IN
            and self._can_run(self.intended, now_s)
            and not self.suffers(FaultKind.ARMING, now_s)
            and self.battery_level(now_s) < 3
            and (not self.parameters["NAV_DLL_ACT"] or self.inputs.hears(InputSource.GROUND_STATION, now_s))
            and not self.breaches()
        )

    def breaches(self) -> list[str]:
        """The events that tell which of its fences it is outside of."""
        return self._breaches_at(self._body.position) if self.gps.placed else []

    def _breaches_at(self, place: Position) -> list[str]:
        if not self.parameters["GF_ACTION"]:
            return []
        farthest_m, highest_m = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        outside = {
            "check_gf_violation_max_hor_dist": 0 < farthest_m < ground_distance_m(place, HOME),
            "check_gf_violation_max_alt": 0 < highest_m < place.altitude_m,
            "check_gf_violation_custom_gf": not all(area.allows(place) for area in self.fence.areas),
        }
        return [name for name, is_outside in outside.items() if is_outside]

    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""
        if self._grounded:
            shown = self._shows_takeoff(now_s)
            return LandedState.TAKEOFF if shown else LandedState.ON_GROUND
        if self.mode is Mode.TAKEOFF:
            return LandedState.TAKEOFF
        lands = self.mode is Mode.LAND or (self.mode is Mode.RTL and self._navigator.lands_at_home)
        return LandedState.LANDING if lands and not self.descends_blindly else LandedState.IN_AIR

    # --- commands --------------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Result:
        """Starts the motors, once the checks pass."""
        if self.armed:
            return Result.ACCEPTED
        if not forced and not self.armable(now_s):
            self.happened("commander_arm_denied_resolve_failures")
            return Result.TEMPORARILY_REJECTED
        self._start_motors(now_s)
        self._ever_armed = True
        self._navigator.takeoff_altitude_m = None
        self.inputs.arm(now_s)
        self.happened("commander_armed_by", DISARMED_BY_COMMAND)
        return Result.ACCEPTED

    def disarm(self, now_s: float, *, forced: bool = False) -> Result:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        if not self.armed:
            return Result.ACCEPTED
        if not self._grounded:
            if not forced:
                return Result.TEMPORARILY_REJECTED
            self._falls = True
        self._disarm(DISARMED_BY_COMMAND)
        return Result.ACCEPTED

    def set_mode(self, mode: Mode) -> Result:
        """Changes what it is meant to do; armed only to what it could do now. LAND is always obeyed."""
        if not self._intend(mode, force=mode is Mode.LAND):
            return Result.TEMPORARILY_REJECTED
        if mode is Mode.TAKEOFF and self.armed and self._lifting_s is None:
            self._take_off_to(self._body.altitude_m + self.parameters["MIS_TAKEOFF_ALT"])
        self._choose_mode()
        return Result.ACCEPTED

    def take_off(self, altitude_m: float) -> Result:
        """Climbs to the altitude above home, NaN for the usual one, and then holds.

        As a PX4 it accepts what makes no sense, turns its motors and stays where it is.
        """
        if not self._intend(Mode.TAKEOFF):
            return Result.TEMPORARILY_REJECTED
        if math.isnan(altitude_m):
            altitude_m = self._body.altitude_m + self.parameters["MIS_TAKEOFF_ALT"]
        if self.armed:
            self._take_off_to(altitude_m)
        self._choose_mode()
        return Result.ACCEPTED

    def reposition(self, now_s: float, wish: Reposition) -> Result:
        """Flies there, or holds where it can stop; without altitude at the present one.

        A place outside the fence causes an event only, and no flight. Disarmed it only changes its mode.
        """
        target = wish.target(self._body.position)
        if not is_sensible(target, lowest_m=LOWEST_M):
            return Result.DENIED
        was_mode = self.mode
        if not self._intend(Mode.LOITER):
            return Result.TEMPORARILY_REJECTED
        self._choose_mode()
        if not self.armed or self._grounded:
            return Result.ACCEPTED
        if self._breaches_at(target):
            self.happened("navigator_reposition_outside_geofence")
            return Result.ACCEPTED
        self._navigator.reposition(wish, now_s, was_holding=was_mode is Mode.LOITER)
        return Result.ACCEPTED

    def change_speed(self, speed_m_s: float) -> Result:
        """Sets the speed of the present mode: lost before the take-off ends."""
        if self.mode is Mode.LOITER:
            self._navigator.change_speed(speed_m_s)
        return Result.ACCEPTED

    def follow(self, now_s: float, setpoint: Setpoint) -> None:
        """Takes a setpoint for OFFBOARD; in any other mode it only counts as a sign of life."""
        self._take_setpoint(now_s, setpoint)

    def move_sticks(self, now_s: float, sticks: Sticks) -> None:
        """Takes a pilot's sticks; where they take over, the mode becomes POSCTL."""
        if not self.parameters["COM_RC_IN_MODE"]:
            return
        known = self.inputs.hears(InputSource.STICKS, now_s)
        self.inputs.take(InputSource.STICKS, now_s)
        self.inputs.sticks = sticks
        override = round(self.parameters["COM_RC_OVERRIDE"])
        overridable = (override & 1 and self.mode in _AUTO) or (override & 2 and self.mode is Mode.OFFBOARD)
        if not (
            known and self.armed and overridable and sticks.moved(self.parameters["COM_RC_STICK_OV"] / 100)
        ):
            return
        critical = Cause.CRITICAL_BATTERY, Cause.EMERGENCY_BATTERY
        if self._failsafe.waits or any(self._failsafe.because_of(cause) for cause in critical):
            return
        was_safe = not self.fails_safe
        if self._intend(Mode.POSCTL) and was_safe:
            self.happened("commander_rc_override")
        self._choose_mode()

    def hear(self, source: InputSource, now_s: float) -> None:
        """A ground station or a companion computer is alive."""
        if self.inputs.take(source, now_s):
            self.happened(REGAINED[source])

    # --- what it is meant to do, and what it does -----------------------------------------------------------

    def _intend(self, mode: Mode, *, force: bool = False) -> bool:
        if self.armed and not force and not self._can_run(mode, self._time_s):
            return False
        if self.armed and self._failsafe.overrule():
            self.happened("failsafe_rc_override")
        self.intended = mode
        if mode not in _NOT_TO_ARM_IN:
            self._after_disarming = mode
        return True

    def _can_run(self, mode: Mode, now_s: float) -> bool:
        if mode is Mode.MISSION:
            return False
        if mode is Mode.OFFBOARD:
            return self.hears_setpoints(now_s)
        if mode in MANUAL:
            return self.inputs.hears(InputSource.STICKS, now_s) and (
                self.gps.placed or mode is not Mode.POSCTL
            )
        return self.gps.placed

    def _choose_mode(self) -> None:
        action = self._failsafe.action
        mode = MODES_OF_ACTIONS.get(action, self.intended) if action else self.intended
        if mode is not self.mode:
            before, self.mode = self.mode, mode
            if mode is not Mode.TAKEOFF:
                self._lifting_s = None
            self._navigator.enter(mode, before=before, armed=self.armed)

    def _disarm(self, reason: int) -> None:
        self._stop_motors()
        self._failsafe.clear()
        self.happened("commander_disarmed_by", reason)
        self.intended = self._after_disarming
        self._choose_mode()

    # --- a step ---------------------------------------------------------------------------------------------

    def _live(self) -> None:
        self._receive_setpoints()
        self._look_for_gps()
        for event in self.inputs.lost(self._time_s - STEP_S, self._time_s):
            self.happened(event)
        if self.armed:
            delay_s = self.parameters["COM_FAIL_ACT_T"]
            dangers = dict((*self._lost_links(), *self._dangers()))
            for change in self._failsafe.watch(dangers, self._time_s, delay_s=delay_s):
                breaches = self.breaches()
                announce(change, self.intended, breaches, delay_s=delay_s, tell=self.happened)
            if self._failsafe.action in (Action.DISARM, Action.TERMINATE):
                self._falls = not self._grounded
                self._disarm(DISARMED_BY_COMMAND)
        self._choose_mode()
        self._fly()

    def _look_for_gps(self) -> None:
        now_s = self._time_s
        blind = self.suffers(FaultKind.GPS, now_s) or self.booting(now_s)
        self.gps.look(0 if blind else self.parameters["SIM_GPS_USED"], now_s)

    def _dangers(self) -> Iterator[tuple[Cause, Danger]]:
        """The present dangers, and the actions that its parameters want for them."""
        level, choice = self.battery_level(self._time_s), round(self.parameters["COM_LOW_BAT_ACT"])
        if level >= 2:
            yield Cause.LOW_BATTERY, Danger(Action.WARN)
        if level >= 3 and choice in (2, 3):
            yield Cause.CRITICAL_BATTERY, Danger(Action.LAND if choice == 2 else Action.RTL)
        if level >= 4 and choice in (2, 3):
            yield Cause.EMERGENCY_BATTERY, Danger(Action.LAND)
        action = FENCE_ACTIONS.get(round(self.parameters["GF_ACTION"]))
        if action and self.breaches():
            yield Cause.GEOFENCE, Danger(action, sticks=True)
        if not self.gps.placed and self.intended not in _BLIND_MODES and not self._grounded:
            yield Cause.POSITION, Danger(Action.DESCEND, at_once=True)

    def _lost_links(self) -> Iterator[tuple[Cause, Danger]]:
        now_s, inputs = self._time_s, self.inputs
        if (
            self.intended is Mode.OFFBOARD
            and self.gps.placed
            and not inputs.hears(InputSource.SETPOINTS, now_s)
        ):
            action = OFFBOARD_ACTIONS.get(round(self.parameters["COM_OBL_RC_ACT"]), Action.WARN)
            yield Cause.OFFBOARD, Danger(action, at_once=True)
        wanted = LINK_ACTIONS.get(round(self.parameters["NAV_DLL_ACT"]))
        if wanted and inputs.misses(InputSource.GROUND_STATION, now_s):
            yield Cause.GROUND_STATION, Danger(wanted)
        wanted = LINK_ACTIONS.get(round(self.parameters["NAV_RCL_ACT"]))
        forgiving = round(self.parameters["COM_RCL_EXCEPT"]) & _EXCEPTION_BITS.get(self.intended, 0)
        if wanted and inputs.misses(InputSource.STICKS, now_s) and not forgiving:
            yield Cause.MANUAL_CONTROL, Danger(wanted)

    def _fly(self) -> None:
        mode = self.mode
        if self._ends_takeoff(mode):
            self.intended = self._after_disarming = Mode.LOITER
            self._choose_mode()
        self._step(mode, blindly=self.descends_blindly)
        if (reason := self._why_disarm()) is not None:
            self._disarm(reason)
        self._look_for_ground()
