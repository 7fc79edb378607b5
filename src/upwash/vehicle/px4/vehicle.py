"""What the stand-in does when told, as a PX4 would: modes, arming, take-off, repositions, OFFBOARD, fail-safes.

It lives in steps of `STEP_S`: whoever asks or commands it says what time it is, and it catches up. Nothing here needs
a clock, a socket or a timer.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto

from upwash.core.geo import GeoPosition, LocalFrame, Position, Velocity, ground_distance_m
from upwash.errors import UsageError
from upwash.mavlink_px4 import Mode
from upwash.vehicle.answers import LandedState, Result
from upwash.vehicle.faults import Fault, FaultKind
from upwash.vehicle.px4.airframe import (
    ALTITUDE_REACHED_M,
    BELIEVES_GROUND_S,
    BLIND_SINKING_M_S,
    CLIMB_M_S,
    CLIMBING_M_S2,
    FOLLOWING_LAG_S,
    REACTION_S,
    STEP_S,
    Body,
    Steering,
    landing_sink_m_s,
    spool_up_s,
)
from upwash.vehicle.px4.events import Events
from upwash.vehicle.px4.failsafe import Action, Cause, Change, Danger, Failsafe
from upwash.vehicle.px4.fence import Fence
from upwash.vehicle.px4.parameters import Parameters

_FARTHEST_M, _HIGHEST_M, _LOWEST_M = 10_000.0, 1_000.0, -200.0
_SLOWEST_M_S, _FASTEST_M_S = 0.1, 30.0
_BOOT_S = 1.0
_FIRST_CHECKS_S = 2.0
_FIX_SETTLES_S = 2.2  # after GPS has come back, until it knows where it is
_BLIND_AFTER_S = 5.0  # without GPS, until it no longer does
_FEWEST_SATELLITES = 4
_HEARTBEATS_LATE_S = 1.9  # that long after COM_DL_LOSS_T, or COM_OBC_LOSS_T, a peer counts as lost
_COMPANION_LATE_S = 1.5
_DISARMS_LATE_S = 1.0  # after COM_DISARM_PRFLT
_TAKEOFF_SEEN_S, _TAKEOFF_SHOWN_S = 1.0, 1.2  # after the command, long before it lifts
_LEAST_LIFT_M = 0.3
_HOME_MOVES_M = 0.3  # at arming: the height of home was an estimate until then
_LANDS_WITHIN_M = 2.0
_TURNS_BEYOND_M = 2.0
_TOUCHING_M = 0.02
_EMPTY_PERCENT = 6.0
_FULL_V, _EMPTY_V = 16.2, 14.4
_GRAVITY_M_S2 = 9.8
_THROTTLE_MIDDLE, _THROTTLE_UP = 500, 700
_DEADZONE = 0.1
FORCED = 21196  # PX4's magic number, to arm and to disarm
_DISARMED_BY_COMMAND, _DISARMED_BY_LANDING, _DISARMED_BEFORE_FLIGHT = 4, 6, 7


@dataclass(frozen=True, slots=True)
class Px4Settings:
    """A PX4 multicopter: where it stands, and what it is like at boot.

    With `one_peer` it answers, over UDP, only the first who spoke to it, until it is switched off.
    """

    home: GeoPosition
    home_altitude_m: float = 0.0  # above the sea
    armable_after_s: float = 4.0
    battery_percent: float = 100.0
    endurance_s: float = 1_200.0  # of a full battery with the motors running
    speedup: float = 1.0  # of its clock, against everyone else's
    faults: tuple[Fault, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    one_peer: bool = False

    def __post_init__(self) -> None:
        for name in ("endurance_s", "speedup"):
            if not 0 < getattr(self, name) < math.inf:
                raise UsageError(f"vehicle: {name} is {getattr(self, name)}; give a number above 0")
        if not self.armable_after_s >= 0:
            raise UsageError(f"vehicle: armable_after_s is {self.armable_after_s}; give a number from 0 on")
        if not 0 <= self.battery_percent <= 100:
            raise UsageError(f"vehicle: battery_percent is {self.battery_percent}; give 0 to 100")
        if not math.isfinite(self.home_altitude_m):
            raise UsageError(f"vehicle: home_altitude_m is {self.home_altitude_m}; give a number of metres")


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
    throttle: float = _THROTTLE_MIDDLE

    def moved(self, threshold: float) -> bool:
        """Whether somebody has hold of them."""
        return max(abs(self.forward), abs(self.right), abs(self.turn)) > threshold


class _Returning(Enum):
    """How far it has come in RTL."""

    CLIMBS = auto()
    FLIES = auto()
    LANDS = auto()


_MANUAL = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.ACRO, Mode.STABILIZED)
_AUTO = (Mode.TAKEOFF, Mode.LOITER, Mode.MISSION, Mode.RTL, Mode.LAND)
_NOT_TO_ARM_IN = (Mode.RTL, Mode.LAND, Mode.MISSION)
_FENCE_ACTIONS = {1: Action.WARN, 2: Action.HOLD, 3: Action.RTL, 5: Action.LAND}
_OFFBOARD_ACTIONS = {
    0: Action.POSCTL,
    1: Action.ALTCTL,
    2: Action.STABILIZED,
    3: Action.RTL,
    4: Action.LAND,
    5: Action.HOLD,
    7: Action.DISARM,
}
_LINK_ACTIONS = {1: Action.HOLD, 2: Action.RTL, 3: Action.LAND, 6: Action.DISARM}
_MODES_OF_ACTIONS = {
    Action.POSCTL: Mode.POSCTL,
    Action.ALTCTL: Mode.ALTCTL,
    Action.STABILIZED: Mode.STABILIZED,
    Action.HOLD: Mode.LOITER,
    Action.RTL: Mode.RTL,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.LAND,
}
_NAMED_CAUSES = {
    Cause.MANUAL_CONTROL: 1,
    Cause.GROUND_STATION: 2,
    Cause.CRITICAL_BATTERY: 4,
    Cause.EMERGENCY_BATTERY: 5,
}
_HOME = Position(0.0, 0.0)


class Quadrotor:
    """A multicopter between two steps."""

    def __init__(self, settings: Px4Settings, *, now_s: float) -> None:
        self.settings = settings
        self.frame = LocalFrame(settings.home)
        self.parameters = Parameters(settings.parameters)
        self.faults = list(settings.faults)
        self.events = Events()
        self.fence = Fence()
        self.mode = Mode.LOITER
        self.intended = Mode.LOITER
        self._after_disarming = Mode.LOITER
        self._failsafe = Failsafe()
        self._body = Body()
        self._booted_s = self._time_s = now_s
        self._armed_s: float | None = None
        self._disarms_s: float | None = None
        self._ever_armed = False
        self._grounded, self._flew = True, False
        self._falls = False
        self._lifting_s: float | None = None  # since when
        self._touched_s: float | None = None
        self._place: Position | None = None
        self._altitude_m = 0.0
        self._heading_deg: float | None = None
        self._moves_s = now_s
        self._cruise_m_s = self.parameters["MPC_XY_CRUISE"]
        self._takeoff_altitude_m: float | None = None
        self._returning = _Returning.CLIMBS
        self._setpoint, self._setpoint_s = Setpoint(), -math.inf
        self._setpoints: deque[tuple[float, Setpoint]] = deque()  # on their way, and when they arrive
        self._sticks, self._sticks_s = Sticks(), -math.inf
        self._sticks_at_arming = self._sticks_known = False
        self._ground_station_s = self._companion_s = -math.inf
        self._ground_station_known = self._companion_known = False
        self._ground_station_at_arming = False
        self._fix_s: float | None = None  # since when it has one, or has lost it
        self._has_fix, self._placed = False, False
        self._battery_percent, self._drains_since_s = settings.battery_percent, now_s

    # --- what it reports ------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Catches up with the time."""
        while self._time_s + STEP_S <= now_s:
            self._time_s += STEP_S
            self._live()

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""
        self.advance(now_s)
        since_s = min(max(0.0, now_s - self._time_s), STEP_S)
        here, velocity = self._body.position, self._body.velocity
        return Position(
            here.east_m + velocity.east_m_s * since_s,
            here.north_m + velocity.north_m_s * since_s,
            max(0.0, here.altitude_m + velocity.up_m_s * since_s),
        )

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""
        self.advance(now_s)
        return self._body.velocity

    def heading_deg(self, now_s: float) -> float:
        """Where its nose points, clockwise from north."""
        self.advance(now_s)
        return self._body.heading_deg

    def home_altitude_m(self) -> float:
        """Of its home above the sea, as it knows it: before the first arming not very well."""
        return self.settings.home_altitude_m - (0.0 if self._ever_armed else _HOME_MOVES_M)

    def target(self) -> Position | None:
        """Where it flies to by itself or in OFFBOARD, if anywhere."""
        if not self.armed or self._grounded:
            return None
        if self.mode is Mode.OFFBOARD:
            if self._setpoint.east_north_m is None or self._setpoint.altitude_m is None:
                return None
            return Position(*self._setpoint.east_north_m, self._setpoint.altitude_m)
        return replace(self._place, altitude_m=self._altitude_m) if self._place else None

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return now_s - self._booted_s

    def booting(self, now_s: float) -> bool:
        """Whether it does not speak yet."""
        return self.uptime_s(now_s) < min(_BOOT_S, self.settings.armable_after_s)

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""
        return any(fault.kind is kind and fault.lasts(self.uptime_s(now_s)) for fault in self.faults)

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        return self._armed_s is not None

    @property
    def flying(self) -> bool:
        """Whether it is off the ground."""
        return not self._grounded

    @property
    def fails_safe(self) -> bool:
        """Whether a fail-safe has it, or will in a moment."""
        return self._failsafe.action is not None

    @property
    def descends_blindly(self) -> bool:
        """Whether it only sinks, without knowing where it is; its mode looks like LAND."""
        return self._failsafe.action is Action.DESCEND

    @property
    def placed(self) -> bool:
        """Whether it knows where it is."""
        return self._placed

    @property
    def ever_had_fix(self) -> bool:
        """Whether its GPS ever told it where it is."""
        return self._fix_s is not None

    @property
    def has_fix(self) -> bool:
        """Whether its GPS tells it where it is."""
        return self._has_fix

    def checked(self, now_s: float) -> bool:
        """Whether its first checks have run."""
        return self.uptime_s(now_s) >= min(_FIRST_CHECKS_S, self.settings.armable_after_s)

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""
        drained = (now_s - self._drains_since_s) * 100 / self.settings.endurance_s if self.armed else 0.0
        left = max(0.0, self._battery_percent - drained)
        return min(left, _EMPTY_PERCENT) if self.suffers(FaultKind.BATTERY, now_s) else left

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery_percent(now_s) / 100

    def battery_level(self, now_s: float) -> int:
        """MAV_BATTERY_CHARGE_STATE: 1 well, 2 low, 3 critical, 4 emergency."""
        left = self.battery_percent(now_s) / 100
        return 1 + sum(
            left <= self.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
        )

    def hears_sticks(self, now_s: float) -> bool:
        """Whether a pilot's sticks are heard."""
        return now_s - self._sticks_s <= self.parameters["COM_RC_LOSS_T"]

    def hears_ground_station(self, now_s: float) -> bool:
        """Whether a ground station is heard."""
        return now_s - self._ground_station_s <= self.parameters["COM_DL_LOSS_T"] + _HEARTBEATS_LATE_S

    def hears_companion(self, now_s: float) -> bool:
        """Whether a companion computer is heard."""
        return now_s - self._companion_s <= self.parameters["COM_OBC_LOSS_T"] + _COMPANION_LATE_S

    def hears_setpoints(self, now_s: float) -> bool:
        """Whether setpoints for OFFBOARD are heard."""
        return now_s - self._setpoint_s <= self.parameters["COM_OF_LOSS_T"] and self._placed

    def armable(self, now_s: float) -> bool:
        """Whether its checks would let it be armed now."""
        return (
            self.checked(now_s)
            and self.intended not in _NOT_TO_ARM_IN
            and self._can_run(self.intended, now_s)
            and not self.suffers(FaultKind.ARMING, now_s)
            and self.battery_level(now_s) < 3
            and (not self.parameters["NAV_DLL_ACT"] or self.hears_ground_station(now_s))
            and not self._breaches()
        )

    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""
        if self._grounded:
            shown = self._lifting_s is not None and now_s >= self._lifting_s + _TAKEOFF_SHOWN_S
            return LandedState.TAKEOFF if shown else LandedState.ON_GROUND
        if self.mode is Mode.TAKEOFF:
            return LandedState.TAKEOFF
        lands = self.mode is Mode.LAND or (self.mode is Mode.RTL and self._returning is _Returning.LANDS)
        return LandedState.LANDING if lands and not self.descends_blindly else LandedState.IN_AIR

    # --- what it is told ------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Result:
        """Starts the motors, once the checks pass."""
        self.advance(now_s)
        if self.armed:
            return Result.ACCEPTED
        if not forced and not self.armable(now_s):
            self._happened("commander_arm_denied_resolve_failures")
            return Result.TEMPORARILY_REJECTED
        self._armed_s = self._drains_since_s = now_s
        self._ever_armed, self._flew, self._disarms_s = True, False, None
        self._takeoff_altitude_m = self._lifting_s = None
        self._sticks_at_arming = self.hears_sticks(now_s)
        self._ground_station_at_arming = self.hears_ground_station(now_s)
        self._happened("commander_armed_by", _DISARMED_BY_COMMAND)
        return Result.ACCEPTED

    def disarm(self, now_s: float, *, forced: bool = False) -> Result:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        self.advance(now_s)
        if not self.armed:
            return Result.ACCEPTED
        if not self._grounded:
            if not forced:
                return Result.TEMPORARILY_REJECTED
            self._falls = True
        self._disarm(_DISARMED_BY_COMMAND)
        return Result.ACCEPTED

    def set_mode(self, now_s: float, mode: Mode) -> Result:
        """Changes what it is meant to do; armed only to what it could do now. LAND is always obeyed."""
        self.advance(now_s)
        if not self._intend(mode, force=mode is Mode.LAND):
            return Result.TEMPORARILY_REJECTED
        if mode is Mode.TAKEOFF and self.armed and self._lifting_s is None:
            self._take_off_to(self._body.altitude_m + self.parameters["MIS_TAKEOFF_ALT"])
        self._choose_mode()
        return Result.ACCEPTED

    def take_off(self, now_s: float, altitude_m: float) -> Result:
        """Climbs to the altitude above home, NaN for the usual one, and then holds.

        As a PX4 it accepts what makes no sense, turns its motors and stays where it is.
        """
        self.advance(now_s)
        if not self._intend(Mode.TAKEOFF):
            return Result.TEMPORARILY_REJECTED
        if math.isnan(altitude_m):
            altitude_m = self._body.altitude_m + self.parameters["MIS_TAKEOFF_ALT"]
        if self.armed:
            self._take_off_to(altitude_m)
        self._choose_mode()
        return Result.ACCEPTED

    def reposition(
        self,
        now_s: float,
        *,
        east_north_m: tuple[float, float] | None,
        altitude_m: float | None,
        speed_m_s: float,
        yaw_deg: float | None,
    ) -> Result:
        """Flies there, or holds where it can stop; without altitude at the present one.

        Outside the fence it says so in an event only, and flies nowhere. Disarmed it only changes its mode.
        """
        self.advance(now_s)
        here = self._body.position
        target = Position(*(east_north_m or (here.east_m, here.north_m)), here.altitude_m)
        if altitude_m is not None:
            target = replace(target, altitude_m=altitude_m)
        if not is_sensible(target):
            return Result.DENIED
        was_mode = self.mode
        if not self._intend(Mode.LOITER):
            return Result.TEMPORARILY_REJECTED
        self._choose_mode()
        if not self.armed or self._grounded:
            return Result.ACCEPTED
        if not self._may_be_at(target):
            self._happened("navigator_reposition_outside_geofence")
            return Result.ACCEPTED
        if 0 < speed_m_s < math.inf:
            self._cruise_m_s = speed_m_s
        elif was_mode is not Mode.LOITER:
            self._cruise_m_s = self.parameters["MPC_XY_CRUISE"]
        if east_north_m is not None:
            self._place = target
        elif altitude_m is None and yaw_deg is None:
            self._place = None
        self._altitude_m = target.altitude_m
        self._heading_deg = yaw_deg
        self._moves_s = now_s + REACTION_S
        return Result.ACCEPTED

    def change_speed(self, now_s: float, speed_m_s: float) -> Result:
        """Sets the speed of the present mode: lost before the take-off ends."""
        self.advance(now_s)
        if 0 < speed_m_s < math.inf and self.mode is Mode.LOITER:
            self._cruise_m_s = speed_m_s
        return Result.ACCEPTED

    def follow(self, now_s: float, setpoint: Setpoint) -> None:
        """Takes a setpoint for OFFBOARD; in any other mode it only shows that somebody streams them."""
        self.advance(now_s)
        self._setpoints.append((now_s + FOLLOWING_LAG_S, setpoint))
        self._setpoint_s = now_s

    def move_sticks(self, now_s: float, sticks: Sticks) -> None:
        """Takes a pilot's sticks; where they take over, the mode becomes POSCTL."""
        self.advance(now_s)
        if not self.parameters["COM_RC_IN_MODE"]:
            return
        known = self.hears_sticks(now_s)
        self._sticks, self._sticks_s, self._sticks_known = sticks, now_s, True
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
            self._happened("commander_rc_override")
        self._choose_mode()

    def hear_ground_station(self, now_s: float) -> None:
        """A ground station is alive."""
        self.advance(now_s)
        if self._ground_station_known and not self.hears_ground_station(now_s):
            self._happened("commander_dl_regained")
        self._ground_station_s, self._ground_station_known = now_s, True

    def hear_companion(self, now_s: float) -> None:
        """A companion computer is alive."""
        self.advance(now_s)
        if self._companion_known and not self.hears_companion(now_s):
            self._happened("commander_onboard_ctrl_regained")
        self._companion_s, self._companion_known = now_s, True

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""
        self.faults.append(Fault(kind, begins_s=self.uptime_s(now_s)))

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""
        self.faults = [fault for fault in self.faults if fault.kind is not kind]

    # --- what it is meant to do, and what it does -----------------------------------------------------------

    def _intend(self, mode: Mode, *, force: bool = False) -> bool:
        if self.armed and not force and not self._can_run(mode, self._time_s):
            return False
        if self.armed and self._failsafe.overrule():
            self._happened("failsafe_rc_override")
        self.intended = mode
        if mode not in _NOT_TO_ARM_IN:
            self._after_disarming = mode
        return True

    def _can_run(self, mode: Mode, now_s: float) -> bool:
        if mode is Mode.MISSION:
            return False
        if mode is Mode.OFFBOARD:
            return self.hears_setpoints(now_s)
        if mode in _MANUAL:
            return self.hears_sticks(now_s) and (self._placed or mode is not Mode.POSCTL)
        return self._placed

    def _choose_mode(self) -> None:
        action = self._failsafe.action
        mode = _MODES_OF_ACTIONS.get(action, self.intended) if action else self.intended
        if mode is not self.mode:
            before, self.mode = self.mode, mode
            self._enter(before)

    def _enter(self, before: Mode) -> None:
        if self.mode is not Mode.TAKEOFF:
            self._lifting_s = None if self._grounded else self._lifting_s
        if self.mode is Mode.LOITER and before is Mode.TAKEOFF:
            self._cruise_m_s = self.parameters["MPC_XY_CRUISE"]
            return
        self._place, self._heading_deg = None, None
        self._altitude_m = self._body.altitude_m
        self._cruise_m_s = self.parameters["MPC_XY_CRUISE"]
        if self.mode is Mode.RTL and self.armed:
            self._begin_return()

    def _begin_return(self) -> None:
        self._returning = _Returning.CLIMBS
        away_m = ground_distance_m(self._body.position, _HOME)
        if away_m > self.parameters["RTL_MIN_DIST"]:
            self._altitude_m = max(self._altitude_m, self.parameters["RTL_RETURN_ALT"])
        above_sea_m = self._altitude_m + self.settings.home_altitude_m
        self._happened("vrtl_return_at", round(above_sea_m), round(self._altitude_m))

    def _take_off_to(self, altitude_m: float) -> None:
        self._takeoff_altitude_m = None
        if not self._body.altitude_m + _LEAST_LIFT_M < altitude_m <= _HIGHEST_M:
            if not self._grounded:
                self._takeoff_altitude_m = self._body.altitude_m
            return
        self._takeoff_altitude_m = altitude_m
        self._lift()

    def _lift(self) -> None:
        if self._grounded and self._lifting_s is None:
            self._lifting_s = self._time_s
            self._disarms_s = None

    def _disarm(self, reason: int) -> None:
        self._battery_percent = self.battery_percent(self._time_s)
        self._armed_s = self._disarms_s = self._lifting_s = None
        self._failsafe.clear()
        self._happened("commander_disarmed_by", reason)
        self.intended = self._after_disarming
        self._choose_mode()

    # --- a step ---------------------------------------------------------------------------------------------

    def _live(self) -> None:
        while self._setpoints and self._setpoints[0][0] <= self._time_s:
            _, self._setpoint = self._setpoints.popleft()
        self._look_for_gps()
        self._listen()
        if self.armed:
            delay_s = self.parameters["COM_FAIL_ACT_T"]
            for change in self._failsafe.watch(dict(self._dangers()), self._time_s, delay_s=delay_s):
                self._tell(change)
            if self._failsafe.action is Action.DISARM:
                self._falls = not self._grounded
                self._disarm(_DISARMED_BY_COMMAND)
        self._choose_mode()
        self._fly()
        self._watch_the_ground()

    def _look_for_gps(self) -> None:
        now_s = self._time_s
        satellites = 0 if self.suffers(FaultKind.GPS, now_s) else self.parameters["SIM_GPS_USED"]
        has_fix = satellites >= _FEWEST_SATELLITES and not self.booting(now_s)
        first = self._fix_s is None
        if has_fix != self._has_fix:
            self._has_fix, self._fix_s = has_fix, now_s
            if has_fix and first:
                self._fix_s = self._booted_s
        if self._fix_s is None:
            return
        if has_fix and not self._placed:
            settles_s = self.settings.armable_after_s if self._fix_s == self._booted_s else _FIX_SETTLES_S
            self._placed = now_s >= self._fix_s + settles_s
        elif not has_fix and self._placed:
            self._placed = now_s < self._fix_s + _BLIND_AFTER_S

    def _listen(self) -> None:
        now_s = self._time_s
        before_s = now_s - STEP_S
        if self._companion_known and self.hears_companion(before_s) > self.hears_companion(now_s):
            self._happened("commander_mission_comp_lost")
        if self._ground_station_known and self.hears_ground_station(before_s) > self.hears_ground_station(
            now_s
        ):
            self._happened("commander_gcs_lost")
        if self._sticks_known and self.hears_sticks(before_s) > self.hears_sticks(now_s):
            self._happened("commander_rc_lost")

    def _dangers(self) -> list[tuple[Cause, Danger]]:
        now_s, of = self._time_s, self.parameters
        dangers: list[tuple[Cause, Danger]] = []
        if self.intended is Mode.OFFBOARD and not self.hears_setpoints(now_s) and self._placed:
            action = _OFFBOARD_ACTIONS.get(round(of["COM_OBL_RC_ACT"]), Action.WARN)
            dangers.append((Cause.OFFBOARD, Danger(action, at_once=True)))
        action_of = _LINK_ACTIONS.get(round(of["NAV_DLL_ACT"]))
        if action_of and self._ground_station_at_arming and not self.hears_ground_station(now_s):
            dangers.append((Cause.GROUND_STATION, Danger(action_of)))
        action_of = _LINK_ACTIONS.get(round(of["NAV_RCL_ACT"]))
        lost = self._sticks_at_arming and not self.hears_sticks(now_s)
        if action_of and lost and not self._forgives_lost_sticks():
            dangers.append((Cause.MANUAL_CONTROL, Danger(action_of)))
        dangers += self._battery_dangers()
        if self._breaches() and (action_of := _FENCE_ACTIONS.get(round(of["GF_ACTION"]))):
            dangers.append((Cause.GEOFENCE, Danger(action_of, sticks=True)))
        needs_place = self.intended not in (Mode.MANUAL, Mode.ALTCTL, Mode.ACRO, Mode.STABILIZED)
        if not self._placed and needs_place and not self._grounded:
            dangers.append((Cause.POSITION, Danger(Action.DESCEND, at_once=True)))
        return dangers

    def _forgives_lost_sticks(self) -> bool:
        """COM_RCL_EXCEPT: whether lost sticks do not matter in this mode."""
        bit = {Mode.MISSION: 1, Mode.LOITER: 2, Mode.OFFBOARD: 4}.get(self.intended, 0)
        return bool(round(self.parameters["COM_RCL_EXCEPT"]) & bit)

    def _battery_dangers(self) -> list[tuple[Cause, Danger]]:
        level, choice = self.battery_level(self._time_s), round(self.parameters["COM_LOW_BAT_ACT"])
        dangers = []
        if level >= 2:
            dangers.append((Cause.LOW_BATTERY, Danger(Action.WARN)))
        if level >= 3 and choice in (2, 3):
            dangers.append((Cause.CRITICAL_BATTERY, Danger(Action.LAND if choice == 2 else Action.RTL)))
        if level >= 4 and choice in (2, 3):
            dangers.append((Cause.EMERGENCY_BATTERY, Danger(Action.LAND)))
        return dangers

    def _tell(self, change: Change) -> None:
        if change.action is Action.WARN:
            if change.cause is Cause.LOW_BATTERY:
                self._happened("commander_failsafe_enter_low_bat")
            return
        if change.cause is Cause.GEOFENCE:
            for name in self._breaches():
                self._happened(name, 2**32 - 1, 20)
        named = _NAMED_CAUSES.get(change.cause)
        if change.waits:
            delay_s = round(self.parameters["COM_FAIL_ACT_T"])
            if named:
                self._happened("commander_failsafe_enter_hold", self.intended, change.action, delay_s, named)
            else:
                self._happened("commander_failsafe_enter_generic_hold", self.intended, change.action, delay_s)
        elif change.action is Action.DESCEND:
            self._happened("commander_failsafe_enter_autopilot_disengaged", self.intended, change.action)
        elif named:
            self._happened("commander_failsafe_enter", self.intended, change.action, named)
        else:
            self._happened("commander_failsafe_enter_generic", self.intended, change.action)

    def _happened(self, name: str, *arguments: float) -> None:
        self.events.happened(name, self.uptime_s(self._time_s), *arguments)

    # --- the fence ------------------------------------------------------------------------------------------

    def _breaches(self) -> list[str]:
        """The events that tell which of its fences it is outside of."""
        return self._breaches_at(self._body.position) if self.parameters["GF_ACTION"] and self._placed else []

    def _breaches_at(self, place: Position) -> list[str]:
        farthest_m, highest_m = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        names = []
        if 0 < farthest_m < ground_distance_m(place, _HOME):
            names.append("check_gf_violation_max_hor_dist")
        if 0 < highest_m < place.altitude_m:
            names.append("check_gf_violation_max_alt")
        if not self.fence.allows(place):
            names.append("check_gf_violation_custom_gf")
        return names

    def _may_be_at(self, place: Position) -> bool:
        return not self.parameters["GF_ACTION"] or not self._breaches_at(place)

    # --- how it moves ---------------------------------------------------------------------------------------

    def _fly(self) -> None:
        if self._falls:
            self._body.up_m_s -= _GRAVITY_M_S2 * STEP_S
            self._body.altitude_m += self._body.up_m_s * STEP_S
        elif not self.armed:
            self._body.rest()
        elif self._grounded:
            self._body.rest()
            self._spool_up()
        else:
            self._body.step(self._steering())
        if self._body.altitude_m <= 0 and self._body.up_m_s <= 0:
            self._body.altitude_m = 0.0
            self._body.rest()

    def _spool_up(self) -> None:
        if self.mode is Mode.OFFBOARD and (self._setpoint.altitude_m or 0.0) > _LEAST_LIFT_M:
            self._lift()
        if self.mode in _MANUAL and self.hears_sticks(self._time_s) and self._sticks.throttle > _THROTTLE_UP:
            self._lift()
        if self._lifting_s is None:
            return
        since_s = self._time_s - self._lifting_s
        if since_s - STEP_S < _TAKEOFF_SEEN_S <= since_s:
            self._happened("commander_takeoff_detected")
        if since_s >= spool_up_s:
            self._grounded, self._flew, self._lifting_s = False, True, None
            self._place, self._altitude_m = self._body.position, self._takeoff_altitude_m or 0.0

    def _steering(self) -> Steering:
        if self.descends_blindly:
            return Steering(level=True, altitude_m=-math.inf, sink_m_s=BLIND_SINKING_M_S)
        match self.mode:
            case Mode.TAKEOFF:
                return self._taking_off()
            case Mode.OFFBOARD:
                return self._following()
            case Mode.RTL:
                return self._on_the_way_home()
            case Mode.LAND:
                return self._landing()
            case Mode.LOITER:
                return self._holding()
        return self._by_stick()

    def _taking_off(self) -> Steering:
        target_m = self._takeoff_altitude_m if self._takeoff_altitude_m is not None else self._body.altitude_m
        if abs(target_m - self._body.altitude_m) <= ALTITUDE_REACHED_M:
            self._place, self._altitude_m = self._place or self._body.position, target_m
            self.intended = self._after_disarming = Mode.LOITER
            self._choose_mode()
        return replace(
            self._holding_at(target_m), climb_m_s=CLIMB_M_S, climb_m_s2=CLIMBING_M_S2, turns_to_deg=None
        )

    def _holding(self) -> Steering:
        return self._holding_at(self._altitude_m)

    def _holding_at(self, altitude_m: float) -> Steering:
        """At its place, or to a stop, which is its place from then on."""
        if self._place is None and self._body.told_to_stand:
            self._place = self._body.position
        if self._time_s < self._moves_s:
            return Steering(place=self._body.position, altitude_m=altitude_m)
        return Steering(
            place=self._place,
            cap_m_s=self._within_limits(self._cruise_m_s),
            altitude_m=altitude_m,
            turns_to_deg=self._heading_deg if self._heading_deg is not None else self._course_deg(),
        )

    def _course_deg(self) -> float | None:
        if self._place is None or ground_distance_m(self._place, self._body.position) <= _TURNS_BEYOND_M:
            return None
        east_m, north_m = self._place.east_m - self._body.east_m, self._place.north_m - self._body.north_m
        return math.degrees(math.atan2(east_m, north_m)) % 360

    def _on_the_way_home(self) -> Steering:
        if self._returning is _Returning.CLIMBS:
            if abs(self._altitude_m - self._body.altitude_m) > ALTITUDE_REACHED_M:
                return self._holding()
            self._returning, self._place = _Returning.FLIES, replace(_HOME, altitude_m=self._altitude_m)
        if self._returning is _Returning.FLIES:
            if ground_distance_m(self._body.position, _HOME) > _LANDS_WITHIN_M:
                return self._holding()
            self._returning = _Returning.LANDS
            self._happened("rtl_land_at_destination")
        return self._landing()

    def _landing(self) -> Steering:
        sink_m_s = landing_sink_m_s(self._body.altitude_m)
        return replace(self._holding_at(-math.inf), sink_m_s=sink_m_s, turns_to_deg=None)

    def _following(self) -> Steering:
        setpoint, cap_m_s = self._setpoint, self._within_limits(self.parameters["MPC_XY_VEL_MAX"])
        climb_m_s, sink_m_s = self.parameters["MPC_Z_VEL_MAX_UP"], self.parameters["MPC_Z_VEL_MAX_DN"]
        velocity = setpoint.velocity
        if velocity is not None:
            fast = max(1.0, math.hypot(velocity.east_m_s, velocity.north_m_s) / cap_m_s)
            up_m_s = max(-sink_m_s, min(climb_m_s, velocity.up_m_s))
            velocity = Velocity(velocity.east_m_s / fast, velocity.north_m_s / fast, up_m_s)
        place = None
        if setpoint.east_north_m is not None:
            place = Position(*setpoint.east_north_m, setpoint.altitude_m or 0.0)
        return Steering(
            place=place,
            cap_m_s=cap_m_s,
            stiffly=True,
            velocity=velocity if velocity is not None or place is not None else Velocity(),
            altitude_m=setpoint.altitude_m,
            climb_m_s=climb_m_s,
            sink_m_s=sink_m_s,
            turns_to_deg=setpoint.yaw_deg,
        )

    def _by_stick(self) -> Steering:
        """By the pilot's sticks; without them it brakes and sinks to the ground."""
        if not self.hears_sticks(self._time_s):
            return Steering(velocity=Velocity(), eases=True, altitude_m=-math.inf, sink_m_s=BLIND_SINKING_M_S)
        sticks, most_m_s = self._sticks, self._within_limits(self.parameters["MPC_VEL_MANUAL"])
        if self.mode is not Mode.POSCTL and not sticks.moved(_DEADZONE):
            return Steering(level=True, velocity=Velocity(up_m_s=self._climb_by_stick_m_s()))
        heading = math.radians(self._body.heading_deg)
        forward, right = _past_deadzone(sticks.forward) * most_m_s, _past_deadzone(sticks.right) * most_m_s
        turn_deg = _past_deadzone(sticks.turn) * 90
        return Steering(
            velocity=Velocity(
                forward * math.sin(heading) + right * math.cos(heading),
                forward * math.cos(heading) - right * math.sin(heading),
                self._climb_by_stick_m_s(),
            ),
            eases=True,
            turns_to_deg=self._body.heading_deg + turn_deg if turn_deg else None,
        )

    def _climb_by_stick_m_s(self) -> float:
        share = _past_deadzone((self._sticks.throttle - _THROTTLE_MIDDLE) / _THROTTLE_MIDDLE)
        most = self.parameters["MPC_Z_VEL_MAX_UP" if share > 0 else "MPC_Z_VEL_MAX_DN"]
        return share * most

    def _within_limits(self, speed_m_s: float) -> float:
        return min(
            max(speed_m_s, _SLOWEST_M_S), max(self.parameters["MPC_XY_VEL_MAX"], _SLOWEST_M_S), _FASTEST_M_S
        )

    def _watch_the_ground(self) -> None:
        now_s = self._time_s
        if self.armed and self._grounded:
            self._disarm_on_the_ground()
        if self._grounded:
            return
        touches = self._body.altitude_m <= _TOUCHING_M and self._body.up_m_s <= 0
        if not touches:
            self._touched_s = None
            return
        if self._touched_s is None:
            self._touched_s = now_s
        if self._falls or now_s >= self._touched_s + BELIEVES_GROUND_S:
            self._grounded, self._falls, self._touched_s = True, False, None
            self._happened("commander_landing_detected")
            delay_s = self.parameters["COM_DISARM_LAND"]
            self._disarms_s = now_s + delay_s if self.armed and delay_s > 0 else None

    def _disarm_on_the_ground(self) -> None:
        now_s, before_flight_s = self._time_s, self.parameters["COM_DISARM_PRFLT"]
        if self._disarms_s is not None and now_s >= self._disarms_s:
            self._disarm(_DISARMED_BY_LANDING)
        elif not self._flew and self._lifting_s is None and before_flight_s > 0:
            self._disarm_if_late(before_flight_s)

    def _disarm_if_late(self, before_flight_s: float) -> None:
        if self._armed_s is not None and self._time_s >= self._armed_s + before_flight_s + _DISARMS_LATE_S:
            self._disarm(_DISARMED_BEFORE_FLIGHT)


def is_sensible(target: Position) -> bool:
    """Whether it is a place that a copter could be sent to."""
    near = ground_distance_m(target, _HOME) <= _FARTHEST_M
    return near and _LOWEST_M <= target.altitude_m <= _HIGHEST_M


def _past_deadzone(share: float) -> float:
    if abs(share) <= _DEADZONE:
        return 0.0
    return math.copysign(min(1.0, (abs(share) - _DEADZONE) / (1 - _DEADZONE)), share)
