"""How a stand-in ArduCopter flies: a command draws its whole motion, and the time reads it off."""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Protocol

from upwash.core.geo import Position, Velocity, distance_m
from upwash.core.vehicle.return_place import RallyPoints, ReturnPlace
from upwash.mavlink.version import Version
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.fence import FenceWatch
from upwash.vehicle.ardupilot.settings import FASTEST_M_S, CopterMode, VehicleSettings
from upwash.vehicle.ardupilot.symmetric import Symmetric
from upwash.vehicle.body.copter import GRAVITY_M_S2, HOME, FaultKind, LandedState, Multicopter
from upwash.vehicle.body.kinematics import (
    Motion,
    MotionPart,
    Phase,
    down_to,
    duration_s,
    pause,
    steadily,
)
from upwash.vehicle.body.parameters import ParameterTable

_HIGHEST_M = 1_000.0
_SLOWEST_M_S = 0.1
_CREEPS_M_S, _NEAR_M = 0.6, 1.0  # at the end of a leg, whose way it has drawn to its end
_SAME_TARGET_M = 0.02  # as fine as degrees in 1e-7 are
_CONTACT_NOTICED_S = 1.7  # after touchdown
_UP_BEFORE_REST_S = 0.5  # a take-off counts as done that long before it rests
_ARMING_S = 2.2  # of the spooling up: it begins with arming, not with the command to take off
_TURNS_ABOVE_M_S = 0.5
_USUAL_LOITER_S = 5.0  # of RTL_LOIT_TIME, in the recorded returns
_TURN_STEP_S, _LONGEST_TURN_S = 0.1, 6.0
_MOST_M_S2 = 5.0  # of the parameter's range


class _Doing(Enum):
    """What the present motion is for."""

    NOTHING = auto()
    TAKING_OFF = auto()
    FLYING = auto()
    LANDING = auto()
    FALLING = auto()


class _Airframe(Protocol):
    """The module `airframe`, or a `Symmetric`."""

    @property
    def spool_up_s(self) -> float: ...

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]: ...

    def waypoint_leg(
        self, start: Position, end: Position, *, ground_speed_m_s: float
    ) -> tuple[Phase, ...]: ...

    def redirected(
        self,
        start: Position,
        velocity: Velocity,
        end: Position,
        *,
        ground_speed_m_s: float,
        rests_at: Position | None = None,
    ) -> tuple[MotionPart, ...]: ...

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]: ...

    def way_home(
        self,
        start: Position,
        velocity: Velocity,
        home: Position,
        *,
        ground_speed_m_s: float,
        altitude_m: float,
    ) -> tuple[MotionPart, ...]: ...

    def landing(self, start: Position) -> tuple[Phase, ...]: ...


class CopterFlight(Multicopter):
    """The flight mode, the motors, and the motion that comes of them."""

    settings: VehicleSettings

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        super().__init__(settings, _parameters_at_boot(settings), now_s=now_s)
        self.mode = CopterMode.STABILIZE
        self.home = HOME  # relative to where it was switched on
        self._unsaid: list[Text] = []
        self.fence = FenceWatch(self.parameters, now_s, self.say)
        self._airframe: _Airframe = (
            arducopter
            if settings.acceleration_m_s2 is None
            else Symmetric(settings.acceleration_m_s2, settings.climb_m_s, settings.descent_m_s)
        )
        self._motors_started = False
        self._armed_s = now_s
        self._doing = _Doing.NOTHING
        self._motion: Motion[MotionPart] = Motion(now_s, (), HOME)
        self._lifts_off_s = now_s
        self._descends_s = math.inf
        self._target: Position | None = None
        self._default_speed_cm_s = self.parameters["WPNAV_SPEED"]
        self._speed_m_s = settings.ground_speed_m_s
        self._heading_deg = 0.0
        self._told_deg: float | None = None  # a commanded heading, until its next target
        self._turned_s = now_s

    def say(self, *texts: Text) -> None:
        """Tells everyone."""
        self._unsaid += texts

    def said(self) -> list[Text]:
        """The texts since the last call; each is returned once."""
        unsaid, self._unsaid = self._unsaid, []
        return unsaid

    def position(self, now_s: float) -> Position:
        """The position in m, relative to home."""
        return self._motion.position(now_s)

    def velocity(self, now_s: float) -> Velocity:
        """The velocity in m/s."""
        return self._motion.velocity(now_s)

    def heading_deg(self, now_s: float) -> float:
        """The heading in degrees clockwise from north; the nose follows the way, except in returns and landings."""
        self._turned_s = max(self._turned_s, now_s - _LONGEST_TURN_S)
        while self._turned_s < now_s:
            step_s = min(_TURN_STEP_S, now_s - self._turned_s)
            self._turned_s += step_s
            velocity = self.velocity(self._turned_s)
            fast = velocity.ground_m_s > _TURNS_ABOVE_M_S
            course_deg = math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) if fast else None
            wanted_deg = course_deg if self._told_deg is None else self._told_deg
            if wanted_deg is not None and self.mode is CopterMode.GUIDED:
                left_deg = math.remainder(wanted_deg - self._heading_deg, 360)
                turn_deg = math.copysign(min(abs(left_deg), arducopter.TURN_DEG_S * step_s), left_deg)
                self._heading_deg = (self._heading_deg + turn_deg) % 360
        return self._heading_deg

    def turn_to(self, now_s: float, heading_deg: float) -> None:
        """Turns to the heading by the shortest way until the next target; no effect unless it flies in GUIDED."""
        if self.mode is CopterMode.GUIDED and self.flying(now_s):
            self.heading_deg(now_s)
            self._told_deg = heading_deg

    def target(self, now_s: float) -> Position | None:
        """The target in GUIDED; None without a target, also at a take-off."""
        return self._target if self.mode is CopterMode.GUIDED and self.armed(now_s) else None

    @property
    def climbs_to(self) -> Position | None:
        """The top of its take-off, until its first target."""
        return self._motion.end if self._doing is _Doing.TAKING_OFF else None

    def armed(self, now_s: float) -> bool:
        """Whether its motors run; some time after touchdown, or without a take-off, they stop by themselves."""
        return self._motors_started and now_s < self.motors_stop_s()

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
        """On the ground, in the air, or between: a landing is noticed late, a fall is taken for ground at once."""
        if self._doing is _Doing.FALLING:
            return LandedState.ON_GROUND
        noticed_after_s = min(
            _CONTACT_NOTICED_S, self.settings.auto_disarm_s
        )  # it disarms when it has noticed
        noticed = now_s - noticed_after_s if self._doing is _Doing.LANDING else now_s
        if not self.flying(noticed):
            return LandedState.ON_GROUND
        if self._doing is _Doing.LANDING and now_s >= self._descends_s:
            return LandedState.LANDING
        if self._doing is _Doing.TAKING_OFF and now_s < self._motion.ends_s - _UP_BEFORE_REST_S:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    def motors_stop_s(self) -> float:
        """The time at which the motors stop by themselves; inf if they do not."""
        if self._doing is _Doing.LANDING:
            return self._motion.ends_s + self.settings.auto_disarm_s
        delay_s = self.parameters["DISARM_DELAY"]
        return self._armed_s + delay_s if self._doing is _Doing.NOTHING and delay_s > 0 else math.inf

    def start_motors(self, now_s: float) -> None:
        """Arms the copter on the ground."""
        self._motors_started = True
        self._armed_s = now_s
        self._doing = _Doing.NOTHING
        self._motion = Motion(now_s, (), self.position(now_s))

    def stop_motors(self) -> None:
        """Disarms the copter; one that falls goes on falling."""
        self._motors_started = False

    def climb(self, now_s: float, altitude_m: float) -> bool:
        """Takes off straight up if it stands armed in GUIDED; returns whether it does."""
        ready = self.armed(now_s) and not self.flying(now_s) and self.mode is CopterMode.GUIDED
        if not (ready and 0 < altitude_m <= _HIGHEST_M):
            return False
        self._doing, self._target = _Doing.TAKING_OFF, None
        self._speed_m_s = self._default_speed_m_s()
        here = self.position(now_s)
        begun_s = max(self._armed_s, now_s - min(_ARMING_S, self._airframe.spool_up_s))
        self._lifts_off_s = begun_s + self._airframe.spool_up_s
        climb = self._airframe.takeoff(here, altitude_m)
        self._motion = Motion(begun_s, climb, here.at_altitude(altitude_m))
        return True

    def fly_at(self, now_s: float, speed_m_s: float) -> None:
        """Flies on to the target at that speed; no effect without a target."""
        if self._target is not None and self._doing is _Doing.FLYING:
            self._speed_m_s = speed_m_s
            self._redirect(now_s, self.position(now_s), self._target)

    def fly_to(self, now_s: float, target: Position) -> bool:
        """Flies to the target if it flies in GUIDED; returns whether it does."""
        if self.mode is not CopterMode.GUIDED or not self.flying(now_s):
            return False
        if self._told_deg is not None:
            self.heading_deg(now_s)
            self._told_deg = None
        if self._target is None or distance_m(target, self._target) > _SAME_TARGET_M:
            self._doing, self._target = _Doing.FLYING, target
            self._redirect(now_s, self.position(now_s), target)
        return True

    def take_mode(self, now_s: float, mode: CopterMode, *, pause_s: float = 0.0) -> None:
        """Changes the flight mode, and does in flight what the mode is for; a landing begins after a pause."""
        if self.flying(now_s) and self.armed(now_s) and mode is not self.mode:
            self.heading_deg(now_s)
            self._enter(now_s, mode, pause_s=pause_s)
        self.mode = mode

    def fall(self, now_s: float) -> None:
        """Drops to the ground, without its motors."""
        here = self.position(now_s)
        fall_s = math.sqrt(2 * here.altitude_m / GRAVITY_M_S2)
        down = Phase(here, Velocity(up_m_s=-1.0), 0.0, GRAVITY_M_S2, fall_s)
        self._doing, self._target = _Doing.FALLING, None
        self._motion = Motion(now_s, (down,), here.at_altitude(0.0))

    def shift(self, now_s: float, north_m: float) -> None:
        """Moves the estimated position north by `north_m`; a flight to a target goes on from there."""
        if north_m == 0:
            return
        here = self.position(now_s)
        believed = Position(here.east_m, here.north_m + north_m, here.altitude_m)
        if self._doing is _Doing.FLYING and self.mode is CopterMode.GUIDED:
            self._redirect(now_s, believed, self._target or here)
        else:
            self._motion = Motion(now_s, (), believed)

    def _enter(self, now_s: float, mode: CopterMode, *, pause_s: float) -> None:
        self._target = self._told_deg = None
        self._speed_m_s = self._default_speed_m_s()
        here, velocity = self.position(now_s), self.velocity(now_s)
        if mode not in (CopterMode.RTL, CopterMode.LAND):
            self._doing = _Doing.FLYING
            braking = self._airframe.brake(here, velocity)
            self._motion = Motion(now_s, braking, braking[-1].end if braking else here)
            return
        self._doing = _Doing.LANDING
        stretches: tuple[MotionPart, ...]
        if mode is CopterMode.RTL:
            stretches = self._way_back(here, velocity)
            here = stretches[-1].end
            if (final_m := self._final_altitude_m(now_s)) is not None:
                self._doing = _Doing.FLYING
                end = here.at_altitude(final_m)
                self._motion = Motion(now_s, (*stretches, *self._to_height(here, end)), end)
                return
        else:
            stretches = self._airframe.brake(here, velocity)
            here = stretches[-1].end if stretches else here
            if (left_s := pause_s - duration_s(stretches)) > 0:
                stretches = *stretches, pause(here, left_s)
        self._descends_s = now_s + (duration_s(stretches) if mode is CopterMode.RTL else 0.0)
        stretches = *stretches, *self._airframe.landing(here)
        self._motion = Motion(now_s, stretches, here.at_altitude(0.0))

    def _way_back(self, here: Position, velocity: Velocity) -> tuple[MotionPart, ...]:
        """The motion of a return until its descent, to home or to a rally point."""
        told_cm_s = self.parameters["RTL_SPEED"] or self.parameters["WPNAV_SPEED"]
        place = self._rally_points().chosen(here, self.home.at_altitude(0.0))
        way = self._airframe.way_home(
            here,
            velocity,
            place.position,
            ground_speed_m_s=_within_reason(told_cm_s / 100),
            altitude_m=self._return_altitude_m(place.altitude_m or 0.0) + self.home.altitude_m,
        )
        above = place.position.at_altitude((way[-1].end if way else here).altitude_m)
        waits_s = max(0.0, self.parameters["RTL_LOIT_TIME"] / 1000 - _USUAL_LOITER_S)
        return *way, pause(above, waits_s)

    def _rally_points(self) -> RallyPoints:
        """Those that its fence allows, and its rule of choice."""
        limit_m = self.parameters["RALLY_LIMIT_KM"] * 1000
        points = (
            ReturnPlace(f"rally point {number}", place.at_altitude(0.0), place.altitude_m)
            for number, place in enumerate(self.rally, 1)
            if self.fence.allows(place.at_altitude(place.altitude_m + self.home.altitude_m))
        )
        return RallyPoints(
            tuple(points),
            home_counts=bool(self.parameters["RALLY_INCL_HOME"]),
            limit_m=limit_m if limit_m > 0 else math.inf,
        )

    def _final_altitude_m(self, now_s: float) -> float | None:
        """Where a return ends in a hover; None where it lands, as without its remote control."""
        final_cm = self.parameters["RTL_ALT_FINAL"]
        if final_cm <= 0 or self.suffers(FaultKind.RADIO, now_s):
            return None
        return final_cm / 100 + self.home.altitude_m

    def _to_height(self, here: Position, end: Position) -> tuple[Phase, ...]:
        if end.altitude_m <= here.altitude_m:
            return down_to(self._airframe.landing(here), end.altitude_m)
        return steadily(here, end, duration_s=(end.altitude_m - here.altitude_m) / self.settings.climb_m_s)

    def _return_altitude_m(self, rally_m: float) -> float:
        """The altitude of returns in m, not below that of the rally point, no higher than the fence allows."""
        altitude_m, ceiling_m = max(self.parameters["RTL_ALT"] / 100, rally_m), self.fence.ceiling_m
        return altitude_m if ceiling_m is None else min(altitude_m, ceiling_m)

    def _redirect(self, now_s: float, here: Position, target: Position) -> None:
        """Flies to the target from its present motion."""
        self.heading_deg(now_s)
        velocity = self.velocity(now_s)
        stretches: tuple[MotionPart, ...]
        if velocity.speed_m_s <= _SLOWEST_M_S:
            stretches = self._airframe.waypoint_leg(here, target, ground_speed_m_s=self._speed_m_s)
        else:
            before = self._motion.end
            arrived = velocity.speed_m_s <= _CREEPS_M_S and distance_m(here, before) <= _NEAR_M
            stretches = self._airframe.redirected(
                here,
                velocity,
                target,
                ground_speed_m_s=self._speed_m_s,
                rests_at=before if arrived and distance_m(before, target) > _NEAR_M else None,
            )
        self._motion = Motion(now_s, stretches, target)

    def _default_speed_m_s(self) -> float:
        """The speed of legs without a commanded speed, in m/s: the settings' until the parameter changes."""
        told_cm_s = self.parameters["WPNAV_SPEED"]
        if told_cm_s == self._default_speed_cm_s:
            return self.settings.ground_speed_m_s
        return _within_reason(told_cm_s / 100)


def _parameters_at_boot(settings: VehicleSettings) -> ParameterTable:
    """The delivered ones, changed by the settings."""
    parameters = ParameterTable("ardupilot", new_names=settings.version >= Version(4, 7))
    if settings.acceleration_m_s2 is not None:  # it does not hover above home or land slowly
        parameters.preset("RTL_LOIT_TIME", 0)
        parameters.preset("WPNAV_ACCEL", min(settings.acceleration_m_s2, _MOST_M_S2) * 100)
        parameters.preset("WPNAV_SPEED_UP", settings.climb_m_s * 100)
        for name in ("WPNAV_SPEED_DN", "LAND_SPEED"):
            parameters.preset(name, settings.descent_m_s * 100)
    for name, value in (
        ("WPNAV_SPEED", settings.return_speed_m_s * 100),
        ("RTL_ALT", settings.return_altitude_m * 100),
        ("SIM_SPEEDUP", settings.speedup),
        ("RALLY_TOTAL", len(settings.rally)),
    ):
        parameters.preset(name, value)
    return parameters


def _within_reason(speed_m_s: float) -> float:
    return min(max(speed_m_s, _SLOWEST_M_S), FASTEST_M_S)
