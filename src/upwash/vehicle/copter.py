"""What the stand-in does when told, as an ArduCopter would: modes, arming, take-off, targets, landing.

It draws a whole flight as one motion when a command arrives, and then only reads it off: nothing here needs a
clock, a socket or a timer. Wishes that make no sense, NaN among them, fail every comparison and are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, auto
from typing import Protocol

from upwash.core.geo import GeoPosition, LocalFrame, Position, distance_m, ground_distance_m
from upwash.errors import UsageError
from upwash.vehicle import arducopter
from upwash.vehicle.faults import Fault, FaultKind
from upwash.vehicle.kinematics import Motion, Phase, Velocity, duration_s
from upwash.vehicle.parameters import Parameters
from upwash.vehicle.symmetric import Symmetric

_FARTHEST_M = 10_000.0
_HIGHEST_M = 1_000.0
_SLOWEST_M_S, _FASTEST_M_S = 0.1, 300.0  # a report holds 327 m/s at most
_RATES = ("ground_speed_m_s", "climb_m_s", "descent_m_s", "return_speed_m_s", "endurance_s", "speedup")
_BOOT_S = 2.0
_FIRST_CHECKS_S = 3.0
_ORIGIN_SHARE = 0.5  # of the time until it can be armed, when it first knows where it is
_SAME_TARGET_M = 0.02  # as fine as degrees in 1e-7 are
_DEAD_RECKONING_S = 10.0  # without GPS, before it lands
_EMPTY_PERCENT = 8.0
_FULL_V, _EMPTY_V = 12.6, 10.2
_GRAVITY_M_S2 = 9.8
FORCED_DISARM, FORCED_ARM = 21196, 2989  # ArduPilot's magic numbers


class Mode(IntEnum):
    """The flight modes that the stand-in knows, by ArduCopter's numbers."""

    STABILIZE = 0
    ALT_HOLD = 2
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


@dataclass(frozen=True, slots=True)
class Answer:
    """The reply to a command, with what the vehicle says about it, if anything."""

    result: Result
    text: str = ""


@dataclass(frozen=True, slots=True)
class VehicleSettings:
    """A multicopter: where it stands and how it flies.

    It flies as a recorded ArduCopter did, or, where an acceleration is given, speeds up and brakes with that one,
    climbs and descends at the given rates, and neither spools up nor hovers above its home.
    """

    home: GeoPosition
    home_altitude_m: float = 0.0  # above the sea
    acceleration_m_s2: float | None = None
    climb_m_s: float = 2.5
    descent_m_s: float = 1.5
    ground_speed_m_s: float = 5.4  # of legs whose speed it was not told
    return_speed_m_s: float = 10.0
    return_altitude_m: float = 15.0
    armable_after_s: float = 42.0
    auto_disarm_s: float = 2.0
    battery_percent: float = 100.0
    endurance_s: float = 1_200.0  # of a full battery with the motors running
    speedup: float = 1.0  # of its clock, against everyone else's
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        rates = {name: getattr(self, name) for name in _RATES}
        if self.acceleration_m_s2 is not None:
            rates["acceleration_m_s2"] = self.acceleration_m_s2
        for name, rate in rates.items():
            most = math.inf if name == "endurance_s" else _FASTEST_M_S
            if not 0 < rate <= most:
                raise UsageError(f"vehicle: {name} is {rate}; give a number above 0, at most {most:g}")
        if not self.armable_after_s >= 0:
            raise UsageError(f"vehicle: armable_after_s is {self.armable_after_s}; give a number from 0 on")
        if not 0 <= self.battery_percent <= 100:
            raise UsageError(f"vehicle: battery_percent is {self.battery_percent}; give 0 to 100")


class Airframe(Protocol):
    """How a vehicle flies: `vehicle.arducopter` is one, `Symmetric` another."""

    @property
    def spool_up_s(self) -> float:
        """How long a take-off stays on the ground."""

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up to the altitude."""

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest."""

    def rest_of_leg(
        self, start: Position, end: Position, *, ground_speed_m_s: float, speed_m_s: float
    ) -> tuple[Phase, ...]:
        """From that speed to rest; empty if it is faster than it may be, or could not stop in time."""

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """To rest, straight ahead."""

    def way_home(
        self, start: Position, home: Position, *, ground_speed_m_s: float, altitude_m: float
    ) -> tuple[Phase, ...]:
        """From rest to above home, no lower than the altitude."""

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """From rest straight down to the ground."""


class _Doing(Enum):
    """What the present motion is for."""

    NOTHING = auto()
    TAKING_OFF = auto()
    FLYING = auto()
    LANDING = auto()
    FALLING = auto()


_ACCEPTED = Answer(Result.ACCEPTED)
_MODES = frozenset(Mode)
_GROUND = Position(0.0, 0.0)
_BY_POSITION = (Mode.GUIDED, Mode.LOITER, Mode.RTL, Mode.POSHOLD, Mode.BRAKE)


@dataclass(slots=True)
class _Battery:
    """How full it is, from how long the motors have run."""

    percent: float
    drain_percent_s: float
    draining_since_s: float | None = None

    def left_percent(self, now_s: float) -> float:
        used_s = 0.0 if self.draining_since_s is None else now_s - self.draining_since_s
        return max(0.0, self.percent - used_s * self.drain_percent_s)

    def stop(self, now_s: float) -> None:
        self.percent = self.left_percent(now_s)
        self.draining_since_s = None


class Copter:
    """A multicopter between two commands."""

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        self.settings = settings
        self.frame = LocalFrame(settings.home)
        self.mode = Mode.STABILIZE
        self.faults = list(settings.faults)
        self.parameters = Parameters(
            {
                "WPNAV_SPEED": settings.return_speed_m_s * 100,
                "RTL_ALT": settings.return_altitude_m * 100,
                "SIM_SPEEDUP": settings.speedup,
            }
        )
        self._airframe: Airframe = (
            arducopter
            if settings.acceleration_m_s2 is None
            else Symmetric(settings.acceleration_m_s2, settings.climb_m_s, settings.descent_m_s)
        )
        self._booted_s = now_s
        self._motors_started = False
        self._battery = _Battery(settings.battery_percent, 100 / settings.endurance_s)
        self._doing = _Doing.NOTHING
        self._motion = Motion(now_s, (), _GROUND)
        self._lifts_off_s = now_s
        self._on_leg_from_s = now_s
        self._descends_s = math.inf
        self._target: Position | None = None
        self._takeoff_target: Position | None = None
        self._speed_m_s = settings.ground_speed_m_s
        self._default_speed_cm_s = self.parameters["WPNAV_SPEED"]
        self._heading_deg = 0.0

    # --- what it reports ------------------------------------------------------------------------------------

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""
        return self._motion.position(now_s)

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""
        return self._motion.velocity(now_s)

    def heading_deg(self, now_s: float) -> float:
        """Where its nose points, clockwise from north: to where it last flew."""
        velocity = self.velocity(now_s)
        if math.hypot(velocity.east_m_s, velocity.north_m_s) > _SLOWEST_M_S:
            self._heading_deg = math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) % 360
        return self._heading_deg

    def target(self, now_s: float) -> Position | None:
        """Where it is flying in GUIDED, if anywhere."""
        if self.mode is not Mode.GUIDED or not self.armed(now_s):
            return None
        return self._takeoff_target if self._doing is _Doing.TAKING_OFF else self._target

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return now_s - self._booted_s

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""
        return any(fault.kind is kind and fault.lasts(self.uptime_s(now_s)) for fault in self.faults)

    def booting(self, now_s: float) -> bool:
        """Whether it is not yet up."""
        return self.uptime_s(now_s) < min(_BOOT_S, self.settings.armable_after_s)

    def knows_its_place(self, now_s: float) -> bool:
        """Whether it has an origin to tell positions from."""
        return self.uptime_s(now_s) >= self.settings.armable_after_s * _ORIGIN_SHARE

    def estimates_position(self, now_s: float) -> bool:
        """Whether its position estimate is good enough to fly by."""
        settled = self.uptime_s(now_s) >= self.settings.armable_after_s
        return settled and not self.suffers(FaultKind.GPS, now_s)

    def why_not_armable(self, now_s: float) -> str:
        """What its checks before arming object to; empty when they pass."""
        if self.suffers(FaultKind.ARMING, now_s):
            return "PreArm: Hardware safety switch"
        if self.suffers(FaultKind.GPS, now_s):
            return "PreArm: GPS 1: Bad fix"
        if not self.estimates_position(now_s):
            return "PreArm: Need Position Estimate"
        if self.battery_percent(now_s) <= _EMPTY_PERCENT:
            return "PreArm: Battery 1 below minimum arming voltage"
        return ""

    def seems_armable(self, now_s: float) -> bool:
        """What its health report says: as an ArduCopter's, falsely yes until the first checks ran."""
        unchecked = self.uptime_s(now_s) < min(_FIRST_CHECKS_S, self.settings.armable_after_s)
        return unchecked or not self.why_not_armable(now_s)

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""
        left_percent = self._battery.left_percent(min(now_s, self._motors_stop_s()))
        return min(left_percent, _EMPTY_PERCENT) if self.suffers(FaultKind.BATTERY, now_s) else left_percent

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery_percent(now_s) / 100

    def armed(self, now_s: float) -> bool:
        """Whether its motors run; some time after touchdown they stop by themselves."""
        return self._motors_started and now_s < self._motors_stop_s()

    def flying(self, now_s: float) -> bool:
        """Whether it is off the ground."""
        match self._doing:
            case _Doing.NOTHING:
                return False
            case _Doing.LANDING | _Doing.FALLING:
                return now_s < self._motion.ends_s
            case _:
                return now_s >= self._lifts_off_s

    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""
        if not self.flying(now_s):
            return LandedState.ON_GROUND
        if self._doing is _Doing.LANDING and now_s >= self._descends_s:
            return LandedState.LANDING
        if self._doing is _Doing.TAKING_OFF and now_s < self._motion.ends_s:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    # --- what it is told ------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Starts the motors, once the checks pass."""
        if self.armed(now_s):
            return _ACCEPTED
        if not forced and (reason := self.why_not_armable(now_s)):
            return Answer(Result.FAILED, reason)
        self._battery.stop(min(now_s, self._motors_stop_s()))
        self._battery.draining_since_s = now_s
        self._motors_started = True
        self._doing = _Doing.NOTHING
        return _ACCEPTED

    def disarm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        if self.flying(now_s):
            if not forced:
                return Answer(Result.FAILED)
            self._fall(now_s)
        self._battery.stop(min(now_s, self._motors_stop_s()))
        self._motors_started = False
        return _ACCEPTED

    def take_off(self, now_s: float, altitude_m: float) -> Answer:
        """Climbs straight up, from the ground, armed and in GUIDED."""
        ready = self.armed(now_s) and not self.flying(now_s) and self.mode is Mode.GUIDED
        if not (ready and 0 < altitude_m <= _HIGHEST_M):
            return Answer(Result.FAILED)
        self._doing = _Doing.TAKING_OFF
        self._target = None
        self._speed_m_s = self._default_speed_m_s()
        here = self.position(now_s)
        self._takeoff_target = replace(here, altitude_m=altitude_m)
        self._lifts_off_s = now_s + self._airframe.spool_up_s
        self._move(now_s, self._airframe.takeoff(here, altitude_m), self._takeoff_target)
        return _ACCEPTED

    def change_speed(self, now_s: float, speed_m_s: float) -> Answer:
        """Sets the speed of the legs; as in ArduCopter, accepted and then lost before the first target.

        Unlike an ArduCopter, it brakes to rest first if the new speed is below the present one.
        """
        if not 0 < speed_m_s <= _FASTEST_M_S:
            return Answer(Result.DENIED)
        if self._target is not None and self._doing is _Doing.FLYING:
            self._speed_m_s = speed_m_s
            self._resume(now_s, self._target)
        return _ACCEPTED

    def steer(self, now_s: float, target: Position) -> bool:
        """Flies to the target; in any other state than flying in GUIDED nothing happens and nothing is said."""
        if self.mode is not Mode.GUIDED or not self.flying(now_s) or not is_sensible(target):
            return False
        if self._target is None or distance_m(target, self._target) > _SAME_TARGET_M:
            self._doing = _Doing.FLYING
            self._target = target
            self._depart(now_s, target)
        return True

    def change_mode(self, now_s: float, number: float) -> Answer:
        """Changes the flight mode, and does in flight what the mode is for."""
        if number not in _MODES:
            return Answer(Result.FAILED, "Mode change failed")
        mode = Mode(int(number))
        if self.suffers(FaultKind.GPS, now_s) and mode in _BY_POSITION and self.armed(now_s):
            return Answer(Result.FAILED, f"Mode change to {mode.name} failed: requires position")
        if self.flying(now_s) and self.armed(now_s) and mode is not self.mode:
            self._enter(now_s, mode)
        self.mode = mode
        return _ACCEPTED

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""
        self.faults.append(Fault(kind, begins_s=self.uptime_s(now_s)))

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""
        self.faults = [fault for fault in self.faults if fault.kind is not kind]

    def notice(self, now_s: float) -> str:
        """Reacts to a fault: lands where GPS has been gone for long; returns what it says about it."""
        lost_s = [
            fault.begins_s
            for fault in self.faults
            if fault.kind is FaultKind.GPS and fault.lasts(self.uptime_s(now_s))
        ]
        if not lost_s or self.uptime_s(now_s) < min(lost_s) + _DEAD_RECKONING_S:
            return ""
        if not self.flying(now_s) or self.mode not in _BY_POSITION:
            return ""
        self.change_mode(now_s, Mode.LAND)
        return "EKF Failsafe: changed to LAND Mode"

    def _motors_stop_s(self) -> float:
        """When they stop by themselves."""
        landing = self._doing is _Doing.LANDING
        return self._motion.ends_s + self.settings.auto_disarm_s if landing else math.inf

    # --- how it moves ---------------------------------------------------------------------------------------

    def _enter(self, now_s: float, mode: Mode) -> None:
        self._target = None
        self._speed_m_s = self._default_speed_m_s()
        if mode not in (Mode.RTL, Mode.LAND):
            self._doing = _Doing.FLYING
            self._depart(now_s)
            return
        self._doing = _Doing.LANDING
        phases = self._braked(now_s)
        here = phases[-1].end if phases else self.position(now_s)
        if mode is Mode.RTL:
            way = self._airframe.way_home(
                here,
                _GROUND,
                ground_speed_m_s=self._return_speed_m_s(),
                altitude_m=self.parameters["RTL_ALT"] / 100,
            )
            phases += way
            here = replace(_GROUND, altitude_m=(way[-1].end if way else here).altitude_m)
        self._descends_s = now_s + duration_s(phases)
        phases += self._airframe.landing(here)
        self._move(now_s, phases, replace(here, altitude_m=0.0))

    def _fall(self, now_s: float) -> None:
        here = self.position(now_s)
        fall_s = math.sqrt(2 * here.altitude_m / _GRAVITY_M_S2)
        down = Phase(here, Velocity(up_m_s=-1.0), 0.0, _GRAVITY_M_S2, fall_s)
        self._doing = _Doing.FALLING
        self._target = None
        self._move(now_s, (down,), replace(here, altitude_m=0.0))

    def _depart(self, now_s: float, target: Position | None = None) -> None:
        """Brakes, then flies to the target if there is one."""
        phases = self._braked(now_s)
        here = phases[-1].end if phases else self.position(now_s)
        on_leg_from_s = now_s + duration_s(phases)
        if target is not None:
            phases += self._airframe.waypoint_leg(here, target, ground_speed_m_s=self._speed_m_s)
            here = target
        self._move(now_s, phases, here)
        self._on_leg_from_s = on_leg_from_s

    def _resume(self, now_s: float, target: Position) -> None:
        """Goes on to the target at the present speed limits, without a stop where that can be."""
        speed_m_s = self.velocity(now_s).speed_m_s
        rest: tuple[Phase, ...] = ()
        if now_s >= self._on_leg_from_s and speed_m_s > _SLOWEST_M_S:
            rest = self._airframe.rest_of_leg(
                self.position(now_s), target, ground_speed_m_s=self._speed_m_s, speed_m_s=speed_m_s
            )
        if rest:
            self._move(now_s, rest, target)
        else:
            self._depart(now_s, target)

    def _braked(self, now_s: float) -> tuple[Phase, ...]:
        return self._airframe.brake(self.position(now_s), self.velocity(now_s))

    def _move(self, now_s: float, phases: tuple[Phase, ...], end: Position) -> None:
        self._motion = Motion(now_s, phases, end)

    def _default_speed_m_s(self) -> float:
        """The legs' own speed, until somebody changes the parameter for it."""
        told_cm_s = self.parameters["WPNAV_SPEED"]
        if told_cm_s == self._default_speed_cm_s:
            return self.settings.ground_speed_m_s
        return _within_reason(told_cm_s / 100)

    def _return_speed_m_s(self) -> float:
        return _within_reason((self.parameters["RTL_SPEED"] or self.parameters["WPNAV_SPEED"]) / 100)


def is_sensible(target: Position) -> bool:
    """Whether it is a place that a copter could be sent to."""
    return ground_distance_m(target, _GROUND) <= _FARTHEST_M and 0 <= target.altitude_m <= _HIGHEST_M


def _within_reason(speed_m_s: float) -> float:
    return min(max(speed_m_s, _SLOWEST_M_S), _FASTEST_M_S)
