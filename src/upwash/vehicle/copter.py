"""What the stand-in does when told, as an ArduCopter would: modes, arming, take-off, targets, landing.

It draws a whole flight as one motion when a command arrives, and then only reads it off: nothing here needs a
clock, a socket or a timer. Wishes that make no sense, NaN among them, fail every comparison and are refused.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, auto
from typing import Protocol

from upwash.core.geo import GeoPosition, LocalFrame, Position, Velocity, distance_m, ground_distance_m
from upwash.errors import UsageError
from upwash.vehicle import arducopter
from upwash.vehicle.answers import LandedState, Result
from upwash.vehicle.boot import (
    EKF_FLIES_BY_GPS,
    EKF_HOLDS_STILL,
    INFORMATION,
    NOTICE,
    RECORDED_S,
    WARNING,
    Boot,
    Text,
)
from upwash.vehicle.failsafe import Failsafes
from upwash.vehicle.faults import Fault, FaultKind
from upwash.vehicle.fence import ONLY_AREAS, Area, Breach, FenceItem, breach, needs_place, read_areas
from upwash.vehicle.kinematics import Motion, Phase, Stretch, duration_s
from upwash.vehicle.parameters import Parameters
from upwash.vehicle.symmetric import Symmetric

_FARTHEST_M = 10_000.0
_HIGHEST_M = 1_000.0
_SLOWEST_M_S, _FASTEST_M_S = 0.1, 300.0  # a report holds 327 m/s at most
_RATES = ("ground_speed_m_s", "climb_m_s", "descent_m_s", "return_speed_m_s", "endurance_s", "speedup")
_SAME_TARGET_M = 0.02  # as fine as degrees in 1e-7 are
_EMPTY_PERCENT = 8.0
_FULL_V, _EMPTY_V, _SAGGING_V = 12.6, 10.6, 10.0
_CONTACT_NOTICED_S = 1.7  # after touchdown
_UP_BEFORE_REST_S = 0.5  # a take-off counts as done so long before it rests
_ARMING_S = 2.2  # of the spooling up: it begins with arming, not with the command to take off
_ALIGNS_IN_FLIGHT_M = 2.5
_COMPLAINS_AFTER_DISARMING_S = 2.2
_FAILSAFE_LANDING_PAUSE_S = 4.0
_TURNS_ABOVE_M_S, _TURN_DEG_S = 0.5, 65.0
_TURN_STEP_S, _LONGEST_TURN_S = 0.1, 6.0
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


@dataclass(frozen=True, slots=True)
class Answer:
    """The reply to a command, with what the vehicle says about it, if anything."""

    result: Result
    texts: tuple[Text, ...] = ()


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
    armable_after_s: float = RECORDED_S
    auto_disarm_s: float = 2.0
    battery_percent: float = 100.0
    endurance_s: float = 1_200.0  # of a full battery with the motors running
    speedup: float = 1.0  # of its clock, against everyone else's
    clock_offset_s: float | None = (
        0.0  # of its receiver's time of day, against this machine's; None: it tells none
    )
    parameters: Mapping[str, float] = field(default_factory=dict)
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

    def redirected(
        self, start: Position, velocity: Velocity, end: Position, *, ground_speed_m_s: float
    ) -> tuple[Stretch, ...]:
        """From that velocity to rest at a target."""

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """To rest, straight ahead."""

    def way_home(
        self,
        start: Position,
        velocity: Velocity,
        home: Position,
        *,
        ground_speed_m_s: float,
        altitude_m: float,
    ) -> tuple[Stretch, ...]:
        """To rest above home, no lower than the altitude."""

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
_ARMING, _DISARMING = Text("Arming motors", INFORMATION), Text("Disarming motors", INFORMATION)
_ALIGNED_IN_FLIGHT = tuple(
    Text(f"EKF3 IMU{number} MAG0 in-flight yaw alignment complete", INFORMATION) for number in (0, 1)
)
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
        for name, value in settings.parameters.items():
            if not self.parameters.set(name, value):
                raise UsageError(f"vehicle: it has no parameter {name}, or not with the value {value:g}")
        self.fence_items: tuple[FenceItem, ...] = ()
        self._areas: tuple[Area, ...] = ()
        self._airframe: Airframe = (
            arducopter
            if settings.acceleration_m_s2 is None
            else Symmetric(settings.acceleration_m_s2, settings.climb_m_s, settings.descent_m_s)
        )
        self._booted_s = now_s
        self._booted_unix_s = time.time() + (settings.clock_offset_s or 0.0)
        self._boot = Boot(settings.armable_after_s)
        self._failsafes = Failsafes()
        self._motors_started = False
        self._armed_s = now_s
        self._was_armed = False
        self._aligned_in_flight = False
        self._breach = Breach.NONE
        self._breaches = 0
        self._breached_s = now_s
        self._battery = _Battery(settings.battery_percent, 100 / settings.endurance_s)
        self._doing = _Doing.NOTHING
        self._motion: Motion[Stretch] = Motion(now_s, (), _GROUND)
        self._lifts_off_s = now_s
        self._descends_s = math.inf
        self._target: Position | None = None
        self._takeoff_target: Position | None = None
        self._speed_m_s = settings.ground_speed_m_s
        self._default_speed_cm_s = self.parameters["WPNAV_SPEED"]
        self._heading_deg = 0.0
        self._turned_s = now_s

    # --- what it reports ------------------------------------------------------------------------------------

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""
        return self._motion.position(now_s)

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""
        return self._motion.velocity(now_s)

    def heading_deg(self, now_s: float) -> float:
        """Where its nose points, clockwise from north: it turns to where it flies, unless it returns or lands."""
        self._turned_s = max(self._turned_s, now_s - _LONGEST_TURN_S)
        while self._turned_s < now_s:
            step_s = min(_TURN_STEP_S, now_s - self._turned_s)
            self._turned_s += step_s
            velocity = self.velocity(self._turned_s)
            fast = math.hypot(velocity.east_m_s, velocity.north_m_s) > _TURNS_ABOVE_M_S
            if fast and self.mode is Mode.GUIDED:
                course_deg = math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s))
                left_deg = math.remainder(course_deg - self._heading_deg, 360)
                turn_deg = math.copysign(min(abs(left_deg), _TURN_DEG_S * step_s), left_deg)
                self._heading_deg = (self._heading_deg + turn_deg) % 360
        return self._heading_deg

    def target(self, now_s: float) -> Position | None:
        """Where it is flying in GUIDED, if anywhere."""
        if self.mode is not Mode.GUIDED or not self.armed(now_s):
            return None
        return self._takeoff_target if self._doing is _Doing.TAKING_OFF else self._target

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return now_s - self._booted_s

    def unix_s(self, now_s: float) -> float:
        """The time of day that its receiver tells, in seconds since 1970; 0 while it tells none."""
        tells = self.settings.clock_offset_s is not None and self.has_fix(now_s)
        return self._booted_unix_s + self.uptime_s(now_s) if tells else 0.0

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""
        return any(fault.kind is kind and fault.lasts(self.uptime_s(now_s)) for fault in self.faults)

    def booting(self, now_s: float) -> bool:
        """Whether it is not yet up."""
        return not self._boot.is_up(self.uptime_s(now_s))

    def has_fix(self, now_s: float) -> bool:
        """Whether its receiver knows where it is."""
        return self.hears_satellites(now_s) and not self.suffers(FaultKind.GPS, now_s)

    def hears_satellites(self, now_s: float) -> bool:
        """Whether its receiver is at work."""
        return self._boot.hears_satellites(self.uptime_s(now_s))

    def knows_its_place(self, now_s: float) -> bool:
        """Whether it has an origin to tell positions from."""
        self._look(now_s)
        return self._boot.places(self.uptime_s(now_s))

    def estimates_position(self, now_s: float) -> bool:
        """Whether its position estimate is good enough to fly by."""
        self._look(now_s)
        settled = self._boot.estimates(self.uptime_s(now_s))
        return settled and not self._failsafes.lost_place and not self.suffers(FaultKind.GPS, now_s)

    def ekf_flags(self, now_s: float) -> int:
        """By what its estimate goes, as EKF_STATUS_REPORT tells it."""
        self._look(now_s)
        flags = self._boot.ekf_flags(self.uptime_s(now_s))
        return self._failsafes.ekf_flags if flags == EKF_FLIES_BY_GPS else min(flags, EKF_HOLDS_STILL)

    def critical(self) -> bool:
        """Whether a fail-safe has taken over."""
        return self._failsafes.active

    def fence_status(self, now_s: float) -> tuple[Breach, int, float]:
        """What of the fence is breached, how often any of it was, and how long ago the last time."""
        return self._breach, self._breaches, now_s - self._breached_s

    def keeps_inside(self, position: Position) -> bool:
        """Whether the fence lets it fly there."""
        return breach(self.parameters, self._areas, position) is Breach.NONE

    def set_fence(self, items: tuple[FenceItem, ...]) -> None:
        """Takes the areas of a new fence; ValueError where the items describe none."""
        self._areas = read_areas(items)
        self.fence_items = items
        self.parameters.set("FENCE_TOTAL", len(items))

    def why_not_armable(self, now_s: float) -> tuple[str, ...]:
        """What its checks before arming object to; empty when they pass."""
        self._look(now_s)
        uptime_s = self.uptime_s(now_s)
        if self.booting(now_s):
            return ("System not initialised",)
        placed = self.knows_its_place(now_s)
        reasons = list(self._boot.sensors_object(uptime_s))
        kinds = int(self.parameters["FENCE_TYPE"]) if self.parameters["FENCE_ENABLE"] else -1
        if kinds == 0 or (kinds == ONLY_AREAS and not self._areas):
            reasons.append("Fences enabled, but none selected")
        if self.suffers(FaultKind.ARMING, now_s):
            reasons.append("Hardware safety switch")
        if self.suffers(FaultKind.COMPASS, now_s):
            reasons.append("Compass offsets too high")
        reasons += self._boot.place_objects(
            uptime_s,
            gps=not self.suffers(FaultKind.GPS, now_s),
            by_position=self.mode in _BY_POSITION,
        )
        if not placed and needs_place(self.parameters, self._areas):
            reasons.append("Fence requires position")
        if self._failsafes.battery:
            reasons += ["Battery 1 low voltage failsafe", "Battery failsafe"]
        elif self.battery_percent(now_s) <= _EMPTY_PERCENT:
            reasons.append("Battery 1 below minimum arming voltage")
        if self.suffers(FaultKind.RADIO, now_s) and self.parameters["FS_THR_ENABLE"]:
            reasons.append("Radio failsafe on")
        return tuple(reasons)

    def armable(self, now_s: float) -> bool:
        """What its health report says."""
        return not self.why_not_armable(now_s)

    def _look(self, now_s: float) -> None:
        self._boot.look(self.uptime_s(now_s), gps=not self.suffers(FaultKind.GPS, now_s))

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""
        left_percent = self._battery.left_percent(min(now_s, self._motors_stop_s()))
        return min(left_percent, _EMPTY_PERCENT) if self.suffers(FaultKind.BATTERY, now_s) else left_percent

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""
        if self.suffers(FaultKind.BATTERY, now_s):
            return _SAGGING_V
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery_percent(now_s) / 100

    def used_mah(self, now_s: float) -> float:
        """What was drawn from its battery."""
        left_percent = self._battery.left_percent(min(now_s, self._motors_stop_s()))
        return (100 - left_percent) / 100 * self.parameters["BATT_CAPACITY"]

    def armed(self, now_s: float) -> bool:
        """Whether its motors run; some time after touchdown, or without a take-off, they stop by themselves."""
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
        """On the ground, in the air, or on the way between; a landing is noticed some time after touchdown."""
        noticed = now_s - _CONTACT_NOTICED_S if self._doing is _Doing.LANDING else now_s
        if not self.flying(noticed):
            return LandedState.ON_GROUND
        if self._doing is _Doing.LANDING and now_s >= self._descends_s:
            return LandedState.LANDING
        if self._doing is _Doing.TAKING_OFF and now_s < self._motion.ends_s - _UP_BEFORE_REST_S:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    # --- what it is told ------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Starts the motors, once the checks pass."""
        if self.armed(now_s):
            return _ACCEPTED
        if not forced and (reasons := self.why_not_armable(now_s)):
            return Answer(Result.FAILED, tuple(Text(f"Arm: {reason}") for reason in reasons))
        self._battery.stop(min(now_s, self._motors_stop_s()))
        self._battery.draining_since_s = now_s
        self._motors_started = self._was_armed = True
        self._armed_s = now_s
        self._aligned_in_flight = False
        self._doing = _Doing.NOTHING
        self._motion = Motion(now_s, (), self.position(now_s))
        return Answer(Result.ACCEPTED, (_ARMING,))

    def disarm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        if self.flying(now_s):
            if not forced:
                return Answer(Result.FAILED)
            self._fall(now_s)
        self._battery.stop(min(now_s, self._motors_stop_s()))
        stopped = self.armed(now_s)
        self._motors_started = self._was_armed = False
        return Answer(Result.ACCEPTED, (_DISARMING,) if stopped else ())

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
        begun_s = max(self._armed_s, now_s - min(_ARMING_S, self._airframe.spool_up_s))
        self._lifts_off_s = begun_s + self._airframe.spool_up_s
        self._move(begun_s, self._airframe.takeoff(here, altitude_m), self._takeoff_target)
        return _ACCEPTED

    def change_speed(self, now_s: float, speed_m_s: float) -> Answer:
        """Sets the speed of the legs; as in ArduCopter, accepted and then lost before the first target."""
        if not 0 < speed_m_s <= _FASTEST_M_S:
            return Answer(Result.DENIED)
        if self._target is not None and self._doing is _Doing.FLYING:
            self._speed_m_s = speed_m_s
            self._depart(now_s, self._target)
        return _ACCEPTED

    def steer(self, now_s: float, target: Position) -> bool:
        """Flies to the target; outside its fence, or not flying in GUIDED, nothing happens and nothing is said."""
        if self.mode is not Mode.GUIDED or not self.flying(now_s) or not is_sensible(target):
            return False
        if not self.keeps_inside(target):
            return False
        if self._target is None or distance_m(target, self._target) > _SAME_TARGET_M:
            self._doing = _Doing.FLYING
            self._target = target
            self._depart(now_s, target)
        return True

    def change_mode(self, now_s: float, number: float) -> Answer:
        """Changes the flight mode, and does in flight what the mode is for."""
        if number not in _MODES:
            return Answer(Result.FAILED, (Text("Mode change failed", WARNING),))
        mode = Mode(int(number))
        if self._lacks_place(now_s) and mode in _BY_POSITION and self.armed(now_s):
            refusal = Text(f"Mode change to {mode.name} failed: requires position", WARNING)
            return Answer(Result.FAILED, (refusal,))
        self._take_mode(now_s, mode)
        return _ACCEPTED

    def _take_mode(self, now_s: float, mode: Mode, *, pause_s: float = 0.0) -> None:
        if self.flying(now_s) and self.armed(now_s) and mode is not self.mode:
            self.heading_deg(now_s)
            self._enter(now_s, mode, pause_s=pause_s)
        self.mode = mode

    def _lacks_place(self, now_s: float) -> bool:
        return self._failsafes.lost_place or not self._boot.estimates(self.uptime_s(now_s))

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""
        self.faults.append(Fault(kind, begins_s=self.uptime_s(now_s)))

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""
        self.faults = [fault for fault in self.faults if fault.kind is not kind]

    def hear_ground_station(self, now_s: float) -> None:
        """A heartbeat of the ground station has come, unless it is out of reach."""
        if not self.suffers(FaultKind.GROUND, now_s):
            self._failsafes.heard_ground_s = now_s

    def notice(self, now_s: float) -> tuple[Text, ...]:
        """Reacts to the time and to what is wrong, a few times a second; returns what it says about it."""
        self._look(now_s)
        uptime_s = self.uptime_s(now_s)
        said = [*self._boot.texts(uptime_s)]
        if self._was_armed and not self.armed(now_s):
            self._was_armed = False
            said.append(_DISARMING)
            self._boot.complain_at(uptime_s + _COMPLAINS_AFTER_DISARMING_S)
        high = self.flying(now_s) and self.position(now_s).altitude_m > _ALIGNS_IN_FLIGHT_M
        if high and not self._aligned_in_flight:
            self._aligned_in_flight = True
            said += _ALIGNED_IN_FLIGHT
        said += self._failsafe(now_s)
        said += self._watch_fence(now_s)
        if not self.armed(now_s) and self._boot.complains(uptime_s):
            said += [Text(f"PreArm: {reason}") for reason in self.why_not_armable(now_s)]
        return tuple(said)

    def _failsafe(self, now_s: float) -> Sequence[Text]:
        since_s = {
            kind: self._booted_s + min(fault.begins_s for fault in self.faults if fault.kind is kind)
            for kind in {fault.kind for fault in self.faults if fault.lasts(self.uptime_s(now_s))}
        }
        flying = self.flying(now_s)
        said: list[Text] = []
        for trigger in self._failsafes.triggers(
            now_s,
            since_s,
            self.parameters,
            flying=flying,
            armed=self.armed(now_s),
            low_battery=f"Battery 1 is low {self.battery_v(now_s):.2f}V used {self.used_mah(now_s):.0f} mAh",
            by_position=self.mode in _BY_POSITION and self._boot.estimates(self.uptime_s(now_s)),
        ):
            said += trigger.texts
            self._shift(now_s, trigger.jump_m)
            mode = Mode(trigger.mode) if trigger.mode in _MODES else None
            if mode is not None and flying and self.mode not in (mode, Mode.LAND):
                if self._failsafes.lost_place and mode is not Mode.LAND:
                    mode = Mode.LAND
                pause_s = 0.0 if mode is not Mode.LAND else _FAILSAFE_LANDING_PAUSE_S
                self._take_mode(now_s, mode, pause_s=pause_s)
        return said

    def _watch_fence(self, now_s: float) -> Sequence[Text]:
        found = breach(self.parameters, self._areas, self.position(now_s))
        if not (self.armed(now_s) and self.flying(now_s)):
            found = Breach.NONE
        if found is self._breach:
            return ()
        self._breach = found
        if found is Breach.NONE:
            return (Text("Fence breach cleared", NOTICE),)
        self._breaches += 1
        self._breached_s = now_s
        name = "Max Alt" if found is Breach.HEIGHT else "Circle"
        said = [Text(f"{name} fence breached", NOTICE)]
        if self.parameters["FENCE_ACTION"] and self.mode not in (Mode.RTL, Mode.LAND):
            self._take_mode(now_s, Mode.RTL)
            said.append(Text("Manual recovery started", INFORMATION))
        return said

    def _shift(self, now_s: float, north_m: float) -> None:
        """Its estimate of its place jumps, and it flies on to its target from where it believes to be."""
        if north_m == 0:
            return
        here = self.position(now_s)
        believed = replace(here, north_m=here.north_m + north_m)
        if self._doing is _Doing.FLYING and self.mode is Mode.GUIDED:
            target = self._target or here
            self._redirect(now_s, believed, target)
        else:
            self._motion = Motion(now_s, (), believed)

    def _motors_stop_s(self) -> float:
        """When they stop by themselves."""
        if self._doing is _Doing.LANDING:
            return self._motion.ends_s + self.settings.auto_disarm_s
        delay_s = self.parameters["DISARM_DELAY"]
        return self._armed_s + delay_s if self._doing is _Doing.NOTHING and delay_s > 0 else math.inf

    # --- how it moves ---------------------------------------------------------------------------------------

    def _enter(self, now_s: float, mode: Mode, *, pause_s: float) -> None:
        self._target = None
        self._speed_m_s = self._default_speed_m_s()
        here, velocity = self.position(now_s), self.velocity(now_s)
        if mode not in (Mode.RTL, Mode.LAND):
            self._doing = _Doing.FLYING
            self._stop(now_s)
            return
        self._doing = _Doing.LANDING
        stretches: tuple[Stretch, ...]
        if mode is Mode.RTL:
            stretches = self._airframe.way_home(
                here,
                velocity,
                _GROUND,
                ground_speed_m_s=self._return_speed_m_s(),
                altitude_m=self._return_altitude_m(),
            )
            here = replace(_GROUND, altitude_m=(stretches[-1].end if stretches else here).altitude_m)
        else:
            stretches = self._airframe.brake(here, velocity)
            here = stretches[-1].end if stretches else here
            if (left_s := pause_s - duration_s(stretches)) > 0:
                stretches = *stretches, Phase(here, Velocity(), 0.0, 0.0, left_s)
        self._descends_s = now_s + (duration_s(stretches) if mode is Mode.RTL else 0.0)
        stretches = *stretches, *self._airframe.landing(here)
        self._move(now_s, stretches, replace(here, altitude_m=0.0))

    def _return_altitude_m(self) -> float:
        """As high as it returns, no higher than its fence allows."""
        altitude_m = self.parameters["RTL_ALT"] / 100
        fenced = self.parameters["FENCE_ENABLE"] and int(self.parameters["FENCE_TYPE"]) & 1
        return min(altitude_m, self.parameters["FENCE_ALT_MAX"]) if fenced else altitude_m

    def _fall(self, now_s: float) -> None:
        here = self.position(now_s)
        fall_s = math.sqrt(2 * here.altitude_m / _GRAVITY_M_S2)
        down = Phase(here, Velocity(up_m_s=-1.0), 0.0, _GRAVITY_M_S2, fall_s)
        self._doing = _Doing.FALLING
        self._target = None
        self._move(now_s, (down,), replace(here, altitude_m=0.0))

    def _stop(self, now_s: float) -> None:
        here = self.position(now_s)
        braking = self._airframe.brake(here, self.velocity(now_s))
        self._move(now_s, braking, braking[-1].end if braking else here)

    def _depart(self, now_s: float, target: Position) -> None:
        """Flies to the target from whatever it does."""
        self._redirect(now_s, self.position(now_s), target)

    def _redirect(self, now_s: float, here: Position, target: Position) -> None:
        self.heading_deg(now_s)
        velocity = self.velocity(now_s)
        stretches: tuple[Stretch, ...]
        if velocity.speed_m_s <= _SLOWEST_M_S:
            stretches = self._airframe.waypoint_leg(here, target, ground_speed_m_s=self._speed_m_s)
        else:
            stretches = self._airframe.redirected(here, velocity, target, ground_speed_m_s=self._speed_m_s)
        self._move(now_s, stretches, target)

    def _move(self, begun_s: float, stretches: tuple[Stretch, ...], end: Position) -> None:
        self._motion = Motion(begun_s, stretches, end)

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
