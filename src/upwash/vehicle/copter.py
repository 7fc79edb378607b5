"""What the stand-in does when told, as an ArduCopter would: modes, arming, take-off, targets, landing.

It draws a whole flight as one motion when a command arrives, and then only reads it off: nothing here needs a
clock, a socket or a timer. Wishes that make no sense, NaN among them, fail every comparison and are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, auto

from upwash.core.geo import GeoPosition, Position, distance_m, ground_distance_m
from upwash.errors import UsageError
from upwash.vehicle.kinematics import Motion, Phase, Velocity, braking, duration_s, leg

_FARTHEST_M = 10_000.0
_HIGHEST_M = 1_000.0
_FASTEST_M_S = 300.0  # a report holds 327 m/s at most
_RATES = ("acceleration_m_s2", "ground_speed_m_s", "climb_m_s", "descent_m_s", "return_speed_m_s")


class Mode(IntEnum):
    """The flight modes that the stand-in knows, by ArduCopter's numbers."""

    STABILIZE = 0
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
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
    """A multicopter: where it stands and how it flies."""

    home: GeoPosition
    acceleration_m_s2: float = 1.0
    ground_speed_m_s: float = 5.0
    climb_m_s: float = 2.5
    descent_m_s: float = 1.5
    return_speed_m_s: float = 10.0
    return_altitude_m: float = 15.0
    armable_after_s: float = 1.0
    auto_disarm_s: float = 2.0

    def __post_init__(self) -> None:
        for name in _RATES:
            if not 0 < getattr(self, name) <= _FASTEST_M_S:
                raise UsageError(
                    f"vehicle: {name} is {getattr(self, name)}; give a number above 0, at most {_FASTEST_M_S:g}"
                )


class _Doing(Enum):
    """What the present motion is for."""

    NOTHING = auto()
    TAKING_OFF = auto()
    FLYING = auto()
    LANDING = auto()


_ACCEPTED = Answer(Result.ACCEPTED)
_MODES = frozenset(Mode)


class Copter:
    """A multicopter between two commands."""

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        self.settings = settings
        self.mode = Mode.STABILIZE
        self._booted_s = now_s
        self._motors_started = False
        self._doing = _Doing.NOTHING
        self._motion = Motion(now_s, (), Position(0.0, 0.0))
        self._on_leg_from_s = now_s
        self._descends_s = math.inf
        self._target: Position | None = None
        self._speed_m_s = settings.ground_speed_m_s

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""
        return self._motion.position(now_s)

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""
        return self._motion.velocity(now_s)

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return now_s - self._booted_s

    def armable(self, now_s: float) -> bool:
        """Whether its checks before arming pass."""
        return self.uptime_s(now_s) >= self.settings.armable_after_s

    def armed(self, now_s: float) -> bool:
        """Whether its motors run; some time after touchdown they stop by themselves."""
        stopped = self._doing is _Doing.LANDING and now_s >= self._motion.ends_s + self.settings.auto_disarm_s
        return self._motors_started and not stopped

    def flying(self, now_s: float) -> bool:
        """Whether it is off the ground."""
        landed = self._doing is _Doing.LANDING and now_s >= self._motion.ends_s
        return self._doing is not _Doing.NOTHING and not landed

    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""
        if not self.flying(now_s):
            return LandedState.ON_GROUND
        if self._doing is _Doing.LANDING and now_s >= self._descends_s:
            return LandedState.LANDING
        if self._doing is _Doing.TAKING_OFF and now_s < self._motion.ends_s:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    def arm(self, now_s: float) -> Answer:
        """Starts the motors, once the checks pass."""
        if not self.armable(now_s):
            return Answer(Result.FAILED, "PreArm: Need Position Estimate")
        if not self.armed(now_s):
            self._motors_started = True
            self._doing = _Doing.NOTHING
        return _ACCEPTED

    def disarm(self, now_s: float) -> Answer:
        """Stops the motors, on the ground only."""
        if self.flying(now_s):
            return Answer(Result.FAILED)
        self._motors_started = False
        return _ACCEPTED

    def take_off(self, now_s: float, altitude_m: float) -> Answer:
        """Climbs straight up, from the ground, armed and in GUIDED."""
        ready = self.armed(now_s) and not self.flying(now_s) and self.mode is Mode.GUIDED
        if not (ready and 0 < altitude_m <= _HIGHEST_M):
            return Answer(Result.FAILED)
        self._doing = _Doing.TAKING_OFF
        self._target = None
        self._speed_m_s = self.settings.ground_speed_m_s
        here = self.position(now_s)
        self._depart(now_s, Position(here.east_m, here.north_m, altitude_m))
        return _ACCEPTED

    def change_speed(self, now_s: float, speed_m_s: float) -> Answer:
        """Sets the speed of the legs; as in ArduCopter, accepted and then lost before the first target.

        Unlike an ArduCopter, it brakes to rest first if the new speed is below the present one.
        """
        if not 0 < speed_m_s <= _FASTEST_M_S:
            return Answer(Result.DENIED)
        if self._target is not None:
            self._speed_m_s = speed_m_s
            self._resume(now_s, self._target)
        return _ACCEPTED

    def steer(self, now_s: float, target: Position) -> None:
        """Flies to the target; in any other state than flying in GUIDED nothing happens and nothing is said."""
        sensible = (
            ground_distance_m(target, Position(0.0, 0.0)) <= _FARTHEST_M
            and 0 <= target.altitude_m <= _HIGHEST_M
        )
        if self.mode is not Mode.GUIDED or not self.flying(now_s) or not sensible or target == self._target:
            return
        self._doing = _Doing.FLYING
        self._target = target
        self._depart(now_s, target)

    def change_mode(self, now_s: float, number: float) -> Answer:
        """Changes the flight mode, and does in flight what the mode is for."""
        if number not in _MODES:
            return Answer(Result.FAILED, "Mode change failed")
        mode = Mode(int(number))
        flying = self.flying(now_s)
        if flying and mode is not self.mode:
            self._enter(now_s, mode)
        self.mode = mode
        return _ACCEPTED

    def _enter(self, now_s: float, mode: Mode) -> None:
        self._target = None
        if mode not in (Mode.RTL, Mode.LAND):
            self._doing = _Doing.FLYING
            self._depart(now_s)
            return
        self._doing = _Doing.LANDING
        above = self._above_the_landing_place(now_s, mode)
        self._depart(now_s, *above)
        self._descends_s = self._motion.ends_s
        self._depart(now_s, *above, replace(self._motion.end, altitude_m=0.0))

    def _above_the_landing_place(self, now_s: float, mode: Mode) -> tuple[Position, ...]:
        if mode is Mode.LAND:
            return ()
        here = self.position(now_s)
        altitude_m = max(here.altitude_m, self.settings.return_altitude_m)
        return replace(here, altitude_m=altitude_m), Position(0.0, 0.0, altitude_m)

    def _depart(self, now_s: float, *stops: Position) -> None:
        """Brakes, then flies to one stop after the other."""
        here = self.position(now_s)
        brake = self.settings.acceleration_m_s2
        phases = [*braking(here, self.velocity(now_s), acceleration_m_s2=brake)]
        if phases:
            here = phases[-1].end
        self._on_leg_from_s = now_s + duration_s(phases)
        for stop in stops:
            phases += self._leg(here, stop)
            here = stop
        self._motion = Motion(now_s, tuple(phases), here)

    def _resume(self, now_s: float, target: Position) -> None:
        """Goes on to the target at the present speed limits, without a stop where that can be."""
        here = self.position(now_s)
        speed_m_s = self.velocity(now_s).speed_m_s
        on_the_leg = now_s >= self._on_leg_from_s
        if on_the_leg and speed_m_s <= self._cruise_m_s(here, target):
            self._motion = Motion(now_s, self._leg(here, target, speed_m_s=speed_m_s), target)
        else:
            self._depart(now_s, target)

    def _leg(self, start: Position, end: Position, *, speed_m_s: float = 0.0) -> tuple[Phase, ...]:
        return leg(
            start,
            end,
            cruise_m_s=self._cruise_m_s(start, end),
            acceleration_m_s2=self.settings.acceleration_m_s2,
            speed_m_s=speed_m_s,
        )

    def _cruise_m_s(self, start: Position, end: Position) -> float:
        """The speed on the way at which neither the ground speed nor the climb or descent is exceeded."""
        settings = self.settings
        length_m = distance_m(start, end)
        ground_m = ground_distance_m(start, end)
        rise_m = end.altitude_m - start.altitude_m
        ground_m_s = settings.return_speed_m_s if self._doing is _Doing.LANDING else self._speed_m_s
        vertical_m_s = settings.climb_m_s if rise_m > 0 else settings.descent_m_s
        return min(
            ground_m_s * length_m / ground_m if ground_m else _FASTEST_M_S,
            vertical_m_s * length_m / abs(rise_m) if rise_m else _FASTEST_M_S,
        )
