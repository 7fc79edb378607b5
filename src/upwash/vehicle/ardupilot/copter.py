"""A stand-in ArduCopter's answers to commands (modes, arming, take-off, targets), and what it does unasked.

Wishes that make no sense, NaN among them, fail every comparison and are refused.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.vehicle.ardupilot.boot import EKF_FLIES_BY_GPS, EKF_HOLDS_STILL, INFORMATION, WARNING, Boot, Text
from upwash.vehicle.ardupilot.failsafe import Failsafes
from upwash.vehicle.ardupilot.fence import Breach
from upwash.vehicle.ardupilot.flight import CopterFlight
from upwash.vehicle.ardupilot.settings import BY_POSITION, FASTEST_M_S, CopterMode, VehicleSettings
from upwash.vehicle.body.copter import FaultKind, LandedState, Result, is_sensible

_SAGGING_V = 10.0
_BATTERY_FAULTS = FaultKind.BATTERY, FaultKind.SECOND_BATTERY
_CAPACITIES = "BATT_CAPACITY", "BATT2_CAPACITY"
_ALIGNS_IN_FLIGHT_M = 2.5
_COMPLAINS_AFTER_DISARMING_S = 2.2
_FAILSAFE_LANDING_PAUSE_S = 4.0
_SHUTTER_BUSY_S = 0.1  # CAM1_DURATION
FORCED_DISARM, FORCED_ARM = 21196, 2989  # ArduPilot's magic numbers


@dataclass(frozen=True, slots=True)
class CameraShot:
    """A photo by a camera on a servo, as ArduPilot's AP_Camera_Servo triggers it."""

    number: int
    taken_s: float
    position: Position


_ARMING, _DISARMING = Text("Arming motors", INFORMATION), Text("Disarming motors", INFORMATION)
_ALIGNED_IN_FLIGHT = tuple(
    Text(f"EKF3 IMU{number} MAG0 in-flight yaw alignment complete", INFORMATION) for number in (0, 1)
)
_MODES = frozenset(CopterMode)


class Copter(CopterFlight):
    """A multicopter between two commands."""

    at_most_percent_in_fault, empty_v, full_v = 8.0, 10.6, 12.6

    def __init__(self, settings: VehicleSettings, *, now_s: float) -> None:
        super().__init__(settings, now_s=now_s)
        self._boot = Boot(settings.armable_after_s)
        self._failsafes = Failsafes(
            glitch_m=settings.glitch_m, glitch_cleared_s=settings.glitch_cleared_after_s
        )
        # Of this computer's clock, however fast the vehicle lives: a drone that takes it for true sets its own clock.
        self._unix_ahead_s = time.time() - time.monotonic() + (settings.clock_offset_s or 0.0)
        self._was_armed = False
        self._aligned_in_flight = False
        self._is_up = False  # its take-off has ended
        self._recovers_from_fence = False  # in a mode that its fence has chosen
        self._shots = 0
        self._shutter_free_s = now_s
        self._untold_shots: list[CameraShot] = []

    # --- what it reports ------------------------------------------------------------------------------------

    def booting(self, now_s: float) -> bool:
        """Whether the firmware is still starting."""
        return not self._boot.is_up(self.uptime_s(now_s))

    def hears_satellites(self, now_s: float) -> bool:
        """Whether the receiver has had the time for a fix."""
        return self._boot.hears_satellites(self.uptime_s(now_s))

    def has_fix(self, now_s: float) -> bool:
        """Whether the receiver has a fix."""
        return self.hears_satellites(now_s) and not self.suffers(FaultKind.GPS, now_s)

    def unix_s(self, now_s: float) -> float:
        """The time of day that its receiver tells, in seconds since 1970; 0 while it tells none."""
        tells = self.settings.clock_offset_s is not None and self.has_fix(now_s)
        return time.monotonic() + self._unix_ahead_s if tells else 0.0

    def has_origin(self, now_s: float) -> bool:
        """Whether it has an origin to tell positions from."""
        self._look_for_gps(now_s)
        return self._boot.places(self.uptime_s(now_s))

    def ekf_flags(self, now_s: float) -> int:
        """The sources of its estimate, as EKF_STATUS_REPORT holds them."""
        self._look_for_gps(now_s)
        flags = self._boot.ekf_flags(self.uptime_s(now_s))
        return self._failsafes.ekf_flags if flags == EKF_FLIES_BY_GPS else min(flags, EKF_HOLDS_STILL)

    def critical(self) -> bool:
        """Whether a fail-safe has taken over."""
        return self._failsafes.active

    def why_not_armable(self, now_s: float) -> tuple[str, ...]:
        """The objections of its checks before arming; empty when they pass."""
        if self.booting(now_s):
            return ("System not initialised",)
        placed, uptime_s = self.has_origin(now_s), self.uptime_s(now_s)
        reasons = list(self._boot.sensors_object(uptime_s))
        if self.suffers(FaultKind.ARMING, now_s):
            reasons.append("Hardware safety switch")
        if self.suffers(FaultKind.COMPASS, now_s):
            reasons.append("Compass offsets too high")
        reasons += self._boot.place_objects(
            uptime_s, gps=not self.suffers(FaultKind.GPS, now_s), by_position=self.mode in BY_POSITION
        )
        reasons += self.fence.objections(self.position(now_s) if placed else None)
        if self._failsafes.battery:
            reasons += ["Battery 1 low voltage failsafe", "Battery failsafe"]
        else:
            reasons += [
                f"Battery {number} below minimum arming voltage"
                for number, percent in enumerate(self.batteries_percent(now_s), 1)
                if percent <= self.at_most_percent_in_fault
            ]
        if self.suffers(FaultKind.RADIO, now_s) and self.parameters["FS_THR_ENABLE"]:
            reasons.append("Radio failsafe on")
        return tuple(reasons)

    def armable(self, now_s: float) -> bool:
        """Whether its health report says that it can be armed."""
        return not self.why_not_armable(now_s)

    def charge_percent(self, now_s: float) -> float:
        """The charge of the battery, which drains until the motors stop by themselves."""
        return super().charge_percent(min(now_s, self.motors_stop_s()))

    def battery_v(self, now_s: float, *, number: int = 0) -> float:
        """The voltage of a battery; the first one is number 0."""
        sags = self.suffers(_BATTERY_FAULTS[number], now_s)
        return _SAGGING_V if sags else super().battery_v(now_s, number=number)

    def _says_low(self, now_s: float) -> dict[FaultKind, str]:
        """What it says of each battery that is low."""
        charges = self.charge_percent(now_s), *self.batteries_percent(now_s)[1:]
        said = {}
        for number, percent in enumerate(charges):
            used_mah = (100 - percent) / 100 * self.parameters[_CAPACITIES[number]]
            low = f"Battery {number + 1} is low {self.battery_v(now_s, number=number):.2f}V"
            said[_BATTERY_FAULTS[number]] = f"{low} used {used_mah:.0f} mAh"
        return said

    # --- commands --------------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, forced: bool = False) -> Result:
        """Starts the motors, once the checks pass."""
        if self.armed(now_s):
            return Result.ACCEPTED
        if not forced and (reasons := self.why_not_armable(now_s)):
            self.say(*(Text(f"Arm: {reason}") for reason in reasons))
            return Result.FAILED
        self.start_draining(now_s)
        self.start_motors(now_s)
        self._was_armed, self._aligned_in_flight = True, False
        self.say(_ARMING)
        self.fence.arm()
        return Result.ACCEPTED

    def disarm(self, now_s: float, *, forced: bool = False) -> Result:
        """Stops the motors: on the ground only, unless forced, and then it falls."""
        if self.flying(now_s):
            if not forced:
                return Result.FAILED
            self.fall(now_s)
        self.stop_draining(now_s)
        if self.armed(now_s):
            self.say(_DISARMING)
            self.fence.disarm()
        self.stop_motors()
        self._was_armed = False
        return Result.ACCEPTED

    def take_off(self, now_s: float, altitude_m: float) -> Result:
        """Climbs straight up, from the ground, armed and in GUIDED."""
        return Result.ACCEPTED if self.climb(now_s, altitude_m) else Result.FAILED

    def change_speed(self, now_s: float, speed_m_s: float) -> Result:
        """Sets the speed of the legs; as in ArduCopter, accepted and then lost before the first target."""
        if not 0 < speed_m_s <= FASTEST_M_S:
            return Result.DENIED
        self.fly_at(now_s, speed_m_s)
        return Result.ACCEPTED

    def steer(self, now_s: float, target: Position) -> bool:
        """Flies to the target; a target outside its fence, or outside GUIDED, is ignored in silence."""
        return is_sensible(target) and self.fence.allows(target) and self.fly_to(now_s, target)

    def set_home(self, place: Position) -> Result:
        """Makes the place the home: returns go there, and altitudes count from it."""
        if not is_sensible(place.at_altitude(abs(place.altitude_m))):
            return Result.DENIED
        self.home = place
        return Result.ACCEPTED

    def change_mode(self, now_s: float, number: float) -> Result:
        """Changes the flight mode, and does in flight what the mode is for."""
        if number not in _MODES:
            self.say(Text("Mode change failed", WARNING))
            return Result.FAILED
        mode = CopterMode(int(number))
        estimates = self._boot.estimates(self.uptime_s(now_s)) and not self._failsafes.lost_place
        obstacle = ""
        if mode in BY_POSITION and not estimates:
            obstacle = "requires position"
        elif self._recovers_from_fence and self.fence.locks_mode:
            obstacle = "in fence recovery"
        if obstacle and self.armed(now_s):
            self.say(Text(f"Mode change to {mode.name} failed: {obstacle}", WARNING))
            return Result.FAILED
        self.take_mode(now_s, mode)
        return Result.ACCEPTED

    def shoot(self, now_s: float) -> bool:
        """Takes a photo unless the shutter is still held from the last one; returns whether it did."""
        if now_s < self._shutter_free_s:
            return False
        self._shots, self._shutter_free_s = self._shots + 1, now_s + _SHUTTER_BUSY_S
        self._untold_shots.append(CameraShot(self._shots, now_s, self.position(now_s)))
        return True

    def shots(self) -> Sequence[CameraShot]:
        """The photos since the last call; each is returned once."""
        untold, self._untold_shots = self._untold_shots, []
        return untold

    def hear_ground_station(self, now_s: float) -> None:
        """Notes a heartbeat of the ground station, unless the fault says that none arrives."""
        if not self.suffers(FaultKind.GROUND, now_s):
            self._failsafes.heard_ground_s = now_s

    # --- what it does by itself -----------------------------------------------------------------------------

    def notice(self, now_s: float) -> None:
        """Reacts to the time and to faults, a few times a second."""
        self._look_for_gps(now_s)
        uptime_s = self.uptime_s(now_s)
        self.say(*self._boot.texts(uptime_s))
        if self._was_armed and not self.armed(now_s):
            self._was_armed = False
            self.say(_DISARMING)
            self.fence.disarm()
            self._boot.complain_at(uptime_s + _COMPLAINS_AFTER_DISARMING_S)
        high = self.flying(now_s) and self.position(now_s).altitude_m > _ALIGNS_IN_FLIGHT_M
        if high and not self._aligned_in_flight:
            self._aligned_in_flight = True
            self.say(*_ALIGNED_IN_FLIGHT)
        self._fail_safe(now_s)
        self._watch_fence(now_s)
        if not self.armed(now_s) and self._boot.complains(uptime_s):
            self.tell_objections(now_s)

    def tell_objections(self, now_s: float) -> None:
        """Says why it cannot be armed."""
        self.say(*(Text(f"PreArm: {reason}") for reason in self.why_not_armable(now_s)))

    def _look_for_gps(self, now_s: float) -> None:
        self._boot.look(self.uptime_s(now_s), gps=not self.suffers(FaultKind.GPS, now_s))

    def _fail_safe(self, now_s: float) -> None:
        flying = self.flying(now_s)
        for trigger in self._failsafes.triggers(
            now_s,
            self.faults_since_s(now_s),
            self.parameters,
            flying=flying,
            armed=self.armed(now_s),
            low_batteries=self._says_low(now_s),
            by_position=self.mode in BY_POSITION and self._boot.estimates(self.uptime_s(now_s)),
        ):
            self.say(*trigger.texts)
            self.shift(now_s, trigger.jump_m)
            mode = CopterMode(trigger.mode) if trigger.mode in _MODES else None
            if mode is not None and flying and self.mode not in (mode, CopterMode.LAND):
                if self._failsafes.lost_place:
                    mode = CopterMode.LAND
                pause_s = _FAILSAFE_LANDING_PAUSE_S if mode is CopterMode.LAND else 0.0
                self.take_mode(now_s, mode, pause_s=pause_s)

    def _watch_fence(self, now_s: float) -> None:
        self._switch_fence(self.landed_state(now_s))
        watched = self.armed(now_s) and self.flying(now_s)
        breached = self.fence.watch(self.position(now_s) if watched else None, now_s)
        self._recovers_from_fence &= self.fence.breach is not Breach.NONE
        acts = self.parameters["FENCE_ACTION"] and self.mode not in (CopterMode.RTL, CopterMode.LAND)
        if breached and acts:
            self.take_mode(now_s, CopterMode.RTL)
            self._recovers_from_fence = True
            self.say(Text("Manual recovery started", INFORMATION))

    def _switch_fence(self, state: LandedState) -> None:
        """Switches kinds of the fence on at the end of a take-off and off at a landing."""
        if state in (LandedState.LANDING, LandedState.ON_GROUND):
            self._is_up = False
            self.fence.begin_landing()
        elif state is not LandedState.TAKEOFF and not self._is_up:
            self._is_up = True
            self.fence.end_takeoff()
