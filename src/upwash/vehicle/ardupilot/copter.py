"""What the stand-in does when told, as an ArduCopter would: modes, arming, take-off, targets, landing; and by itself.

`CopterFlight` moves it, `Health` knows its state. Nothing here needs a clock, a socket or a timer. Wishes that make
no sense, NaN among them, fail every comparison and are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upwash.core.geo import LocalFrame, Position, Velocity
from upwash.errors import UsageError
from upwash.vehicle.ardupilot.boot import INFORMATION, WARNING, Text
from upwash.vehicle.ardupilot.camera import ServoCamera
from upwash.vehicle.ardupilot.fence import Breach, FenceWatch
from upwash.vehicle.ardupilot.flight import CopterFlight, is_sensible
from upwash.vehicle.ardupilot.health import Health
from upwash.vehicle.ardupilot.parameters import Parameters
from upwash.vehicle.ardupilot.settings import BY_POSITION, FASTEST_M_S, CopterMode, VehicleSettings
from upwash.vehicle.body.condition import Battery, FaultKind
from upwash.vehicle.body.firmware import LandedState, Result

_EMPTY_PERCENT = 8.0
_FULL_V, _EMPTY_V, _SAGGING_V = 12.6, 10.6, 10.0
_ALIGNS_IN_FLIGHT_M = 2.5
_COMPLAINS_AFTER_DISARMING_S = 2.2
_FAILSAFE_LANDING_PAUSE_S = 4.0
FORCED_DISARM, FORCED_ARM = 21196, 2989  # ArduPilot's magic numbers


@dataclass(frozen=True, slots=True)
class Answer:
    """The reply to a command, with what the vehicle says about it, if anything."""

    result: Result
    texts: tuple[Text, ...] = ()


_ACCEPTED = Answer(Result.ACCEPTED)
_ARMING, _DISARMING = Text("Arming motors", INFORMATION), Text("Disarming motors", INFORMATION)
_ALIGNED_IN_FLIGHT = tuple(
    Text(f"EKF3 IMU{number} MAG0 in-flight yaw alignment complete", INFORMATION) for number in (0, 1)
)
_MODES = frozenset(CopterMode)


class Copter:
    """A multicopter between two commands."""

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        self.settings = settings
        self.frame = LocalFrame(settings.home)
        self.parameters = Parameters(
            {
                "WPNAV_SPEED": settings.return_speed_m_s * 100,
                "RTL_ALT": settings.return_altitude_m * 100,
                "SIM_SPEEDUP": settings.speedup,
            },
            settings.version,
        )
        for name, value in settings.parameters.items():
            if not self.parameters.set(name, value):
                raise UsageError(
                    f"vehicle: version {settings.version} has no parameter {name}, or not with the value {value:g}"
                )
        self.fence = FenceWatch(self.parameters, now_s)
        self.health = Health(settings, now_s=now_s)
        self.camera = ServoCamera()
        self._flight = CopterFlight(
            settings, self.parameters, now_s=now_s, ceiling_m=lambda: self.fence.ceiling_m
        )
        self._was_armed = False
        self._aligned_in_flight = False
        self._is_up = False  # its take-off has ended
        self._recovers_from_fence = False  # in a mode that its fence has chosen
        self._battery = Battery(settings.battery_percent, 100 / settings.endurance_s)

    # --- what it reports ------------------------------------------------------------------------------------

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""
        return self._flight.position(now_s)

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""
        return self._flight.velocity(now_s)

    def heading_deg(self, now_s: float) -> float:
        """Where its nose points, clockwise from north."""
        return self._flight.heading_deg(now_s)

    @property
    def home(self) -> Position:
        """Where it returns to, relative to where it was switched on."""
        return self._flight.home

    @property
    def mode(self) -> CopterMode:
        """Its flight mode."""
        return self._flight.mode

    def target(self, now_s: float) -> Position | None:
        """Where it is flying in GUIDED, if anywhere."""
        return self._flight.target(now_s)

    @property
    def climbs_to(self) -> Position | None:
        """The top of its take-off, until its first target."""
        return self._flight.climbs_to

    def armed(self, now_s: float) -> bool:
        """Whether its motors run."""
        return self._flight.armed(now_s)

    def flying(self, now_s: float) -> bool:
        """Whether it is off the ground."""
        return self._flight.flying(now_s)

    def landed_state(self, now_s: float) -> LandedState:
        """On the ground, in the air, or on the way between."""
        return self._flight.landed_state(now_s)

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""
        return self.health.uptime_s(now_s)

    def suffers(self, kind: FaultKind, now_s: float) -> bool:
        """Whether such a thing is wrong with it now."""
        return self.health.suffers(kind, now_s)

    def critical(self) -> bool:
        """Whether a fail-safe has taken over."""
        return self.health.failsafes.active

    def why_not_armable(self, now_s: float) -> tuple[str, ...]:
        """What its checks before arming object to; empty when they pass."""
        self.health.look(now_s)
        uptime_s = self.uptime_s(now_s)
        if self.health.booting(now_s):
            return ("System not initialised",)
        placed = self.health.knows_its_place(now_s)
        reasons = list(self.health.boot.sensors_object(uptime_s))
        if self.suffers(FaultKind.ARMING, now_s):
            reasons.append("Hardware safety switch")
        if self.suffers(FaultKind.COMPASS, now_s):
            reasons.append("Compass offsets too high")
        reasons += self.health.boot.place_objects(
            uptime_s,
            gps=not self.suffers(FaultKind.GPS, now_s),
            by_position=self.mode in BY_POSITION,
        )
        reasons += self.fence.objections(self.position(now_s) if placed else None)
        if self.health.failsafes.battery:
            reasons += ["Battery 1 low voltage failsafe", "Battery failsafe"]
        elif self.battery_percent(now_s) <= _EMPTY_PERCENT:
            reasons.append("Battery 1 below minimum arming voltage")
        if self.suffers(FaultKind.RADIO, now_s) and self.parameters["FS_THR_ENABLE"]:
            reasons.append("Radio failsafe on")
        return tuple(reasons)

    def armable(self, now_s: float) -> bool:
        """What its health report says."""
        return not self.why_not_armable(now_s)

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""
        left_percent = self._battery.left_percent(min(now_s, self._flight.motors_stop_s()))
        return min(left_percent, _EMPTY_PERCENT) if self.suffers(FaultKind.BATTERY, now_s) else left_percent

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""
        if self.suffers(FaultKind.BATTERY, now_s):
            return _SAGGING_V
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery_percent(now_s) / 100

    def used_mah(self, now_s: float) -> float:
        """What was drawn from its battery."""
        left_percent = self._battery.left_percent(min(now_s, self._flight.motors_stop_s()))
        return (100 - left_percent) / 100 * self.parameters["BATT_CAPACITY"]

    # --- what it is told ------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Starts the motors, once the checks pass."""
        if self.armed(now_s):
            return _ACCEPTED
        if not forced and (reasons := self.why_not_armable(now_s)):
            return Answer(Result.FAILED, tuple(Text(f"Arm: {reason}") for reason in reasons))
        self._battery.stop(min(now_s, self._flight.motors_stop_s()))
        self._battery.draining_since_s = now_s
        self._flight.start_motors(now_s)
        self._was_armed, self._aligned_in_flight = True, False
        return Answer(Result.ACCEPTED, (_ARMING, *self.fence.arm()))

    def disarm(self, now_s: float, *, forced: bool = False) -> Answer:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        if self.flying(now_s):
            if not forced:
                return Answer(Result.FAILED)
            self._flight.fall(now_s)
        self._battery.stop(min(now_s, self._flight.motors_stop_s()))
        stopped = self.armed(now_s)
        self._flight.stop_motors()
        self._was_armed = False
        return Answer(Result.ACCEPTED, (_DISARMING, *self.fence.disarm()) if stopped else ())

    def take_off(self, now_s: float, altitude_m: float) -> Answer:
        """Climbs straight up, from the ground, armed and in GUIDED."""
        return _ACCEPTED if self._flight.take_off(now_s, altitude_m) else Answer(Result.FAILED)

    def change_speed(self, now_s: float, speed_m_s: float) -> Answer:
        """Sets the speed of the legs; as in ArduCopter, accepted and then lost before the first target."""
        if not 0 < speed_m_s <= FASTEST_M_S:
            return Answer(Result.DENIED)
        self._flight.change_speed(now_s, speed_m_s)
        return _ACCEPTED

    def turn(self, now_s: float, heading_deg: float) -> Answer:
        """Turns its nose there until its next target; without effect where it does not fly in GUIDED."""
        self._flight.turn(now_s, heading_deg % 360)
        return _ACCEPTED

    def steer(self, now_s: float, target: Position) -> bool:
        """Flies to the target; outside its fence, or not flying in GUIDED, nothing happens and nothing is said."""
        return is_sensible(target) and self.fence.allows(target) and self._flight.steer(now_s, target)

    def set_home(self, place: Position) -> Answer:
        """Returns there from now on, and tells its altitudes from there."""
        if not is_sensible(place.at_altitude(abs(place.altitude_m))):
            return Answer(Result.DENIED)
        self._flight.home = place
        return _ACCEPTED

    def change_mode(self, now_s: float, number: float) -> Answer:
        """Changes the flight mode, and does in flight what the mode is for."""
        if number not in _MODES:
            return Answer(Result.FAILED, (Text("Mode change failed", WARNING),))
        mode = CopterMode(int(number))
        if self.health.lacks_place(now_s) and mode in BY_POSITION and self.armed(now_s):
            refusal = Text(f"Mode change to {mode.name} failed: requires position", WARNING)
            return Answer(Result.FAILED, (refusal,))
        if self._recovers_from_fence and self.fence.locks_mode and self.armed(now_s):
            refusal = Text(f"Mode change to {mode.name} failed: in fence recovery", WARNING)
            return Answer(Result.FAILED, (refusal,))
        self._flight.take_mode(now_s, mode)
        return _ACCEPTED

    def fail(self, kind: FaultKind, now_s: float) -> None:
        """Something is wrong with it from now on."""
        self.health.fail(kind, now_s)

    def mend(self, kind: FaultKind) -> None:
        """Nothing of that kind is wrong with it any more."""
        self.health.mend(kind)

    def hear_ground_station(self, now_s: float) -> None:
        """A heartbeat of the ground station has come, unless it is out of reach."""
        if not self.suffers(FaultKind.GROUND, now_s):
            self.health.failsafes.heard_ground_s = now_s

    def notice(self, now_s: float) -> tuple[Text, ...]:
        """Reacts to the time and to what is wrong, a few times a second; returns what it says about it."""
        self.health.look(now_s)
        uptime_s = self.uptime_s(now_s)
        said = [*self.health.boot.texts(uptime_s)]
        if self._was_armed and not self.armed(now_s):
            self._was_armed = False
            said += [_DISARMING, *self.fence.disarm()]
            self.health.boot.complain_at(uptime_s + _COMPLAINS_AFTER_DISARMING_S)
        high = self.flying(now_s) and self.position(now_s).altitude_m > _ALIGNS_IN_FLIGHT_M
        if high and not self._aligned_in_flight:
            self._aligned_in_flight = True
            said += _ALIGNED_IN_FLIGHT
        said += self._failsafe(now_s)
        said += self._watch_fence(now_s)
        if not self.armed(now_s) and self.health.boot.complains(uptime_s):
            said += [Text(f"PreArm: {reason}") for reason in self.why_not_armable(now_s)]
        return tuple(said)

    def _failsafe(self, now_s: float) -> Sequence[Text]:
        flying = self.flying(now_s)
        said: list[Text] = []
        for trigger in self.health.failsafes.triggers(
            now_s,
            self.health.since_s(now_s),
            self.parameters,
            flying=flying,
            armed=self.armed(now_s),
            low_battery=f"Battery 1 is low {self.battery_v(now_s):.2f}V used {self.used_mah(now_s):.0f} mAh",
            by_position=self.mode in BY_POSITION and self.health.boot.estimates(self.uptime_s(now_s)),
        ):
            said += trigger.texts
            self._flight.shift(now_s, trigger.jump_m)
            mode = CopterMode(trigger.mode) if trigger.mode in _MODES else None
            if mode is not None and flying and self.mode not in (mode, CopterMode.LAND):
                if self.health.failsafes.lost_place and mode is not CopterMode.LAND:
                    mode = CopterMode.LAND
                pause_s = 0.0 if mode is not CopterMode.LAND else _FAILSAFE_LANDING_PAUSE_S
                self._flight.take_mode(now_s, mode, pause_s=pause_s)
        return said

    def _watch_fence(self, now_s: float) -> Sequence[Text]:
        state, breaches = self.landed_state(now_s), self.fence.breaches
        said = [*self._switch_fence(state)]
        watched = self.armed(now_s) and self.flying(now_s)
        said += self.fence.watch(self.position(now_s) if watched else None, now_s)
        self._recovers_from_fence &= self.fence.breach is not Breach.NONE
        acts = self.parameters["FENCE_ACTION"] and self.mode not in (CopterMode.RTL, CopterMode.LAND)
        if self.fence.breaches > breaches and acts:
            self._flight.take_mode(now_s, CopterMode.RTL)
            self._recovers_from_fence = True
            said.append(Text("Manual recovery started", INFORMATION))
        return said

    def _switch_fence(self, state: LandedState) -> Sequence[Text]:
        """Kinds of its fence are switched on where its take-off ends, and off where it comes down."""
        if state in (LandedState.LANDING, LandedState.ON_GROUND):
            self._is_up = False
            return self.fence.begin_landing()
        if state is LandedState.TAKEOFF or self._is_up:
            return ()
        self._is_up = True
        return self.fence.end_takeoff()
