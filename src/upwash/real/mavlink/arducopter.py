"""The driver of an ArduCopter, steered in GUIDED by targets that it confirms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, ahead, distance_m
from upwash.core.vehicle.return_place import RallyPoints
from upwash.core.vehicle.way_home import ARDUCOPTER as ARDUCOPTER_WAY_HOME
from upwash.errors import AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.version import Version
from upwash.ports import DeadMan, VehicleLimits
from upwash.real.mavlink.autopilot import MavlinkAutopilot
from upwash.real.mavlink.dead_man import LuaDeadMan
from upwash.real.mavlink.fence import ARDUCOPTER_FENCE, arducopter_limits
from upwash.real.mavlink.gate import ABOVE_SEA_M, LATITUDE_E7, LONGITUDE_E7, RANGES
from upwash.real.mavlink.needs import require_reposition
from upwash.real.mavlink.parameters import read_parameters, read_quantities
from upwash.real.mavlink.rally import RallySite, arducopter_rally
from upwash.real.mavlink.telemetry import STREAMS_HZ, FirmwareProfile, VehicleTelemetry
from upwash.real.mavlink.way_home import arducopter_ends, arducopter_energy, arducopter_quantities

_GUIDED, _RTL, _LAND = "GUIDED", "RTL", "LAND"
_NUMBERS = {
    _GUIDED: mavlink.COPTER_MODE_GUIDED,
    _RTL: mavlink.COPTER_MODE_RTL,
    _LAND: mavlink.COPTER_MODE_LAND,
}
_FAILSAFE_MODES = ("RTL", "LAND", "SMART_RTL", "BRAKE", "AUTO", "AUTO_RTL")
_CRITICAL = (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY)
_AVOIDANCE = "OA_TYPE"
_UNPLACED, _EMPTY = "its position estimate failed", "its battery is low"
_ANNOUNCED = {  # by a fail-safe that acts, just before or after its mode (ArduCopter's events.cpp, ekf_check.cpp)
    "Battery Failsafe": _EMPTY,
    "Radio Failsafe": "it does not hear its remote control",
    "GCS Failsafe": "it does not hear its ground station",
    "EKF Failsafe": _UNPLACED,
    "Terrain Failsafe": "it lacks terrain data",
    "Failsafe: Terrain": "it lacks terrain data",
    "Dead Reckoning": _UNPLACED,
    "ADSB": "it avoids another aircraft",
}
_HINTS = {"Battery ": _EMPTY, "EKF variance": _UNPLACED, "GPS Glitch": _UNPLACED}  # without an announcement
_ANNOUNCED_S = 1.0
_NO_CHANGE = ("Cleared", "stopped", " - Continuing")  # of a fail-safe that is over, or leaves the mode
_BRAKES_M_S2 = 1.83  # as recorded flights do (SITL 4.7, default parameters)
_REACTS_S = 0.1
_LIFT_REPORT_S = 1.0  # for a report that it has left the ground, on a lossy link


def _mode_name(number: int) -> str:
    entry = mavlink.enums["COPTER_MODE"].get(number)
    return entry.name.removeprefix("COPTER_MODE_") if entry else f"number {number}"


def _failsafe(telemetry: VehicleTelemetry, mode: str) -> str:
    """Why a fail-safe may have chosen the mode; "" without one."""
    if mode not in _FAILSAFE_MODES:
        return ""
    if telemetry.dead_man:
        return telemetry.dead_man
    if announced := _cause(telemetry.warned_of_mode(before_s=_ANNOUNCED_S), _ANNOUNCED):
        return announced
    if telemetry.fence_breached:
        return "it has left its fence"
    if telemetry.system_status not in _CRITICAL or _is_pilots(telemetry):
        return ""
    return _cause(telemetry.warned_of_mode(), _HINTS) or "its system status is critical"


def _cause(texts: Sequence[str], causes: Mapping[str, str]) -> str:
    """The cause that the first of the texts tells; "" if none does."""
    told = (
        cause
        for text in texts
        if not any(words in text for words in _NO_CHANGE)
        for begin, cause in causes.items()
        if text.startswith(begin)
    )
    return next(told, "")


def _is_pilots(telemetry: VehicleTelemetry) -> bool:
    """Whether the remote control moved with the mode, long after a fail-safe triggered: a status stays critical."""
    was_critical = telemetry.status_s < telemetry.mode_s - _ANNOUNCED_S
    return was_critical and bool(telemetry.remote.moved(telemetry.mode_s))


_LOCAL_TARGET, _FENCE_STATUS, _WIND = (
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_FENCE_STATUS,
    mavlink.MAVLINK_MSG_ID_WIND,
)
_TARGET, _CHANNELS, _BATTERY = (
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
)

ARDUCOPTER = FirmwareProfile(
    name="ArduCopter",
    autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    own_mode=_GUIDED,
    mode_name=_mode_name,
    failsafe=_failsafe,
    keeps_targets=True,
    ranges={
        **RANGES,
        "POSITION_TARGET_GLOBAL_INT": {"lat_int": LATITUDE_E7, "lon_int": LONGITUDE_E7, "alt": ABOVE_SEA_M},
    },
    streams_hz={
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 10.0,  # mode and arming, once a second by itself
        **STREAMS_HZ,
        _LOCAL_TARGET: 5.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
        _FENCE_STATUS: 2.0,
        _WIND: 1.0,
    },
    always_has="FRAME_CLASS",
    oldest=Version(4, 1),
    needs="MAV_CMD_DO_REPOSITION",
    sent_at_times=frozenset({_TARGET, _LOCAL_TARGET, _CHANNELS, _FENCE_STATUS, _WIND, _BATTERY}),
)


class ArduCopterAutopilot(MavlinkAutopilot):
    """The autopilot of an ArduCopter.

    Targets are DO_REPOSITION, which never changes the mode and is refused outside the vehicle's fence.
    """

    return_mode, land_mode, usual_way_home = _RTL, _LAND, ARDUCOPTER_WAY_HOME

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        # ArduCopter accepts a speed before a flight's first target, and loses it: the speed is sent once the
        # vehicle is seen to fly to the first target.
        self._obeys_speed = False
        self._told_speed_s = -math.inf
        self._dead_man = LuaDeadMan(self.vehicle)

    @property
    def stopping_place(self) -> Position:
        """Where the vehicle would come to rest if it braked now: straight ahead, as in recorded flights."""
        velocity = self._telemetry.velocity
        if velocity is None:
            return self.position
        return ahead(self.position, velocity, _REACTS_S + velocity.speed_m_s / (2 * _BRAKES_M_S2))

    @property
    def dead_man(self) -> DeadMan:
        """The dead man's switch: a script in the autopilot."""
        return self._dead_man

    async def learn(self) -> None:
        """Reads the batteries' stages and the way home with its end from the vehicle's parameters."""
        batteries = tuple(self._telemetry.batteries.charges_percent)
        values = await read_quantities(self.vehicle, arducopter_quantities(batteries))
        self._energy = arducopter_energy(values, batteries)
        for setting in arducopter_ends(values):
            self.vehicle.news.tell(setting)

    async def _rally(self, site: RallySite) -> RallyPoints:
        return await arducopter_rally(self.vehicle, site)

    async def _fenced(self, limits: VehicleLimits) -> VehicleLimits:
        parameters = await read_parameters(self.vehicle, [*ARDUCOPTER_FENCE, _AVOIDANCE])
        avoids = parameters.get(_AVOIDANCE, 0.0)
        self._tracker.watches_targets = not avoids
        if avoids:
            advice = (
                "the vehicle changes its own targets to fly round obstacles, so upwash cannot see that a ground "
                "station sends it elsewhere: have the pilot change the mode instead"
            )
            self.vehicle.news.tell(VehicleSetting(name=_AVOIDANCE, value=avoids, advice=advice))
        return await arducopter_limits(self.vehicle, self._frame, limits, parameters)

    async def arm(self) -> None:
        """Once it is known to take targets."""
        async with self.vehicle.limited("arm", self._settings.margin_s):
            await require_reposition(self.vehicle)
        await super().arm()

    async def _climb(self, step: str, altitude_m: float) -> None:
        self._obeys_speed = False
        self._tracker.fix_ground()
        await self._lift_off(step, altitude_m)
        await self._while_ours(step, lambda: self._climbed(altitude_m))

    async def _lift_off(self, step: str, altitude_m: float) -> None:
        """Command the take-off. If only the answer was lost, the vehicle refuses the repeated command in the air."""
        flew, latch = self._telemetry.in_the_air, self.vehicle.latch
        take_off, straight_up = mavlink.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6
        try:
            await self.vehicle.command(
                step, take_off, *straight_up, altitude_m, expect=lambda: latch.expect_target(None)
            )
        except AutopilotRefused:
            self.vehicle.require_control(step)
            if flew or not await self.vehicle.happens(
                step, lambda: self._telemetry.in_the_air, within_s=_LIFT_REPORT_S
            ):
                raise
        latch.settle_target(obeyed=True)

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the following legs, by DO_CHANGE_SPEED once the vehicle obeys that."""
        await super().set_ground_speed(ground_speed_m_s)
        if self._obeys_speed:
            await self._send_speed("set ground speed")

    async def _fly_to(self, step: str, position: Position) -> None:
        await self._send_target(step, position)
        await self._arrival(step, position, self._arrived)

    async def _stop(self) -> None:
        """Brake: aim at the stopping place, so that the vehicle does not fly back."""
        stop = self.stopping_place
        await self._send_target("hold", stop)
        await self._arrival("hold", stop, self._rests_at)

    async def _begin_turn(self, step: str, heading_deg: float) -> None:
        own_rate, shortest_way, from_north = 0.0, 0.0, 0.0
        await self.vehicle.command(
            step, mavlink.MAV_CMD_CONDITION_YAW, heading_deg, own_rate, shortest_way, from_north
        )

    async def _arrival(self, step: str, target: Position, arrived: Callable[[Position], bool]) -> None:
        """Return on arrival; repeat the target, which may have been lost, while the vehicle comes no nearer."""
        vehicle = self.vehicle
        while not arrived(target):
            near_m = distance_m(self.position, target) - self._settings.progress_m

            def changed(near_m: float = near_m) -> bool:
                nearer = distance_m(self.position, target) <= near_m
                return arrived(target) or not vehicle.may_steer or nearer

            progress = await vehicle.happens(step, changed, within_s=self._settings.progress_s)
            vehicle.require_control(step)
            vehicle.require_one(step)
            if not progress:
                await self._send_target(step, target)
            elif not self._obeys_speed or self._is_too_fast():
                await self._send_speed(step)
                self._obeys_speed = True

    async def _send_target(self, step: str, position: Position) -> None:
        """Send the target with its altitude above the sea, which a home moved by a ground station does not change."""
        place, reposition = self._tracker.above_sea(position), mavlink.MAV_CMD_DO_REPOSITION
        target, latch = self._frame.position(place), self.vehicle.latch
        try:
            parameters = (-1.0, 0.0, 0.0, math.nan)
            command = self.vehicle.command_int(reposition, place, mavlink.MAV_FRAME_GLOBAL, *parameters)
            await self.vehicle.accept(step, command, lambda: latch.expect_target(target))
            latch.settle_target(obeyed=True)
        except AutopilotRefused as error:
            latch.settle_target(obeyed=False)
            self.vehicle.require_control(step)
            if self._telemetry.answers.get(reposition) != mavlink.MAV_RESULT_FAILED:
                raise
            problem = f"{error.problem}, as it does to a target outside its own fence"
            raise AutopilotRefused(step, problem, error.vehicle_said) from error

    def _is_too_fast(self) -> bool:
        """Whether the vehicle still flies faster than the speed sent a while ago."""
        settings, velocity = self._settings, self._telemetry.velocity
        limit_m_s = self._ground_speed_m_s * settings.speed_tolerance + settings.arrival_speed_m_s
        too_fast = velocity is not None and velocity.ground_m_s > limit_m_s
        return too_fast and self.vehicle.now_s - self._told_speed_s > settings.speed_again_s

    async def _change_mode(self, step: str, mode: str) -> None:
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, _NUMBERS[mode])
        await self.vehicle.change_mode(step, parameters, mode)

    async def _send_speed(self, step: str) -> None:
        self._told_speed_s = self.vehicle.now_s
        over_ground, same_throttle = mavlink.SPEED_TYPE_GROUNDSPEED, -1
        await self.vehicle.command(
            step, mavlink.MAV_CMD_DO_CHANGE_SPEED, over_ground, self._ground_speed_m_s, same_throttle
        )
