"""An ArduCopter, steered in GUIDED by targets that it answers."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, ahead, distance_m
from upwash.core.vehicle.way_home import ARDUCOPTER as ARDUCOPTER_WAY_HOME
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.errors import AutopilotRefused
from upwash.mavlink.version import Version
from upwash.ports import DeadMan, VehicleLimits, VehicleSetting
from upwash.real.mavlink.autopilot import MavlinkAutopilot, check_speed
from upwash.real.mavlink.dead_man import LuaDeadMan
from upwash.real.mavlink.fence_settings import ARDUCOPTER_FENCE, arducopter_limits
from upwash.real.mavlink.firmware import Firmware
from upwash.real.mavlink.needs import require_reposition
from upwash.real.mavlink.parameters import read_parameters
from upwash.real.mavlink.quantities import read_quantities
from upwash.real.mavlink.ranges import ABOVE_SEA_M, LATITUDE_E7, LONGITUDE_E7, RANGES
from upwash.real.mavlink.telemetry import Telemetry
from upwash.real.mavlink.way_home import ARDUCOPTER_QUANTITIES, arducopter_energy

_GUIDED, _RTL, _LAND = "GUIDED", "RTL", "LAND"
_NUMBERS = {
    _GUIDED: mavlink.COPTER_MODE_GUIDED,
    _RTL: mavlink.COPTER_MODE_RTL,
    _LAND: mavlink.COPTER_MODE_LAND,
}
_FAILSAFE_MODES = ("RTL", "LAND", "SMART_RTL", "BRAKE", "AUTO", "AUTO_RTL")
_CRITICAL = (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY)
_AVOIDANCE = "OA_TYPE"
_FAILSAFE_TEXTS = {
    "EKF": "its position estimate failed",
    "GPS Glitch": "its position estimate failed",
    "Dead Reckoning": "its position estimate failed",
    "Battery": "its battery is low",
    "Radio Failsafe": "it does not hear its remote control",
    "GCS Failsafe": "it does not hear its ground station",
    "Terrain Failsafe": "it lacks terrain data",
    "ADSB": "it avoids another aircraft",
}
_BRAKES_M_S2 = 1.83  # as recorded flights do (SITL 4.7, default parameters)
_REACTS_S = 0.1
_LIFT_REPORT_S = 1.0  # for a report that it has left the ground, while some get lost


def _mode_name(number: int) -> str:
    entry = mavlink.enums["COPTER_MODE"].get(number)
    return entry.name.removeprefix("COPTER_MODE_") if entry else f"number {number}"


def _failsafe(telemetry: Telemetry, mode: str) -> str:
    """Its system status is critical while a fail-safe lasts; a breached fence it tells apart."""
    if mode not in _FAILSAFE_MODES:
        return ""
    if telemetry.dead_man:
        return telemetry.dead_man
    if telemetry.fence_breached:
        return "it has left its fence"
    if telemetry.system_status not in _CRITICAL:
        return ""
    said = (text.text for _, text in reversed(telemetry.texts))
    causes = (cause for text in said for begin, cause in _FAILSAFE_TEXTS.items() if text.startswith(begin))
    return next(causes, "its system status is critical")


ARDUCOPTER = Firmware(
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
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 5.0,  # who changes a mode
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
        mavlink.MAVLINK_MSG_ID_FENCE_STATUS: 2.0,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
        mavlink.MAVLINK_MSG_ID_WIND: 1.0,
    },
    always_has="FRAME_CLASS",
    oldest=Version(4, 1),
    needs="MAV_CMD_DO_REPOSITION",
    sent_at_times=frozenset(
        {
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
            mavlink.MAVLINK_MSG_ID_FENCE_STATUS,
            mavlink.MAVLINK_MSG_ID_WIND,
        }
    ),
)


class ArduCopter(MavlinkAutopilot):
    """Targets are DO_REPOSITION, which never changes the mode and is refused outside the vehicle's fence."""

    return_mode, land_mode = _RTL, _LAND

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        # ArduCopter accepts a speed before a flight's first target, and loses it: it is told once the first
        # target is seen to be flown to.
        self._obeys_speed = False
        self._told_speed_s = -math.inf
        self._energy = EnergyFacts(way_home=ARDUCOPTER_WAY_HOME)
        self._dead_man = LuaDeadMan(self._vehicle)

    @property
    def stopping_place(self) -> Position:
        """Straight ahead, by how recorded flights brake."""
        velocity = self._telemetry.velocity
        if velocity is None:
            return self.position
        return ahead(self.position, velocity, _REACTS_S + velocity.speed_m_s / (2 * _BRAKES_M_S2))

    @property
    def dead_man(self) -> DeadMan:
        """A script in the autopilot."""
        return self._dead_man

    async def limits(self) -> VehicleLimits:
        """Home, and what its parameters and its fence list say; the energy facts are read with them."""
        limits = await super().limits()
        await self.learn()
        told = await read_parameters(self._vehicle, [*ARDUCOPTER_FENCE, _AVOIDANCE])
        self._learn_avoidance(told.get(_AVOIDANCE, 0.0))
        limits = replace(limits, returns_at_m=self._energy.return_altitude_m)
        return await arducopter_limits(self._vehicle, self._frame, limits, told)

    def _learn_avoidance(self, kind: float) -> None:
        """Targets are not compared where the vehicle itself replaces them to fly round obstacles."""
        self._where.watches_targets = not kind
        if kind:
            advice = (
                "the vehicle changes its own targets to fly round obstacles, so upwash cannot see that a ground "
                "station sends it elsewhere: have the pilot change the mode instead"
            )
            self._vehicle.tell(VehicleSetting(_AVOIDANCE, kind, advice))

    async def learn(self) -> None:
        """Its energy facts, and what it can do."""
        self._energy = arducopter_energy(await read_quantities(self._vehicle, ARDUCOPTER_QUANTITIES))

    @property
    def energy(self) -> EnergyFacts:
        """By its parameters, once `limits` has read them; by ArduCopter's own defaults until then."""
        return replace(self._energy, home=super().energy.home)

    async def arm(self) -> None:
        """Tries its firmware, enters GUIDED and starts the motors; tries again while its last checks object."""
        loop, settings = asyncio.get_running_loop(), self._settings
        deadline_s = loop.time() + settings.ready_timeout_s
        async with self._vehicle.limited("arm", settings.ready_timeout_s + settings.margin_s):
            await require_reposition(self._vehicle)
            while True:
                begun_s = self._vehicle.now_s
                try:
                    await self._enter_guided("arm")
                    await self._vehicle.arm("arm", armed=True)
                    self._vehicle.beat()  # from here on its dead man counts what it hears
                    break
                except AutopilotRefused:
                    self._vehicle.require_control("arm")
                    if loop.time() + settings.arm_again_s > deadline_s:
                        raise
                    self._tell_delay(self._reasons_since(begun_s))
                await asyncio.sleep(settings.arm_again_s)
            await self._while_ours("arm", lambda: self._telemetry.position is not None)

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs straight up in GUIDED."""
        step = f"takeoff to {altitude_m:g} m"
        self._obeys_speed = False
        self._where.fix_ground()
        async with self._vehicle.limited(step, self._vertical_s(altitude_m)):
            await self._lift_off(step, altitude_m)
            await self._while_ours(step, lambda: self._climbed(altitude_m))

    async def _lift_off(self, step: str, altitude_m: float) -> None:
        """Commands the take-off; a repeated command is refused in the air, where only its answer was lost."""
        flew, latch = self._telemetry.in_the_air, self._vehicle.latch
        take_off, straight_up = mavlink.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6
        try:
            await self._vehicle.command(
                step, take_off, *straight_up, altitude_m, expect=lambda: latch.expect_target(None)
            )
        except AutopilotRefused:
            self._vehicle.require_control(step)
            if flew or not await self._vehicle.happens(
                step, lambda: self._telemetry.in_the_air, within_s=_LIFT_REPORT_S
            ):
                raise
        latch.settle_target(obeyed=True)

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """By DO_CHANGE_SPEED, once it obeys that."""
        check_speed(ground_speed_m_s)
        self._ground_speed_m_s = ground_speed_m_s
        if self._obeys_speed:
            await self._tell_speed("set ground speed")

    async def goto(self, position: Position) -> None:
        """Sends the target again where it may have been lost."""
        step = f"goto {position.east_m:.1f} m east, {position.north_m:.1f} m north"
        async with self._vehicle.limited(step, self._leg_s(position)):
            await self._send_target(step, position)
            await self._arrival(step, position, self._arrived)

    async def hold(self) -> None:
        """Aims at where it can stop, so that it does not fly back."""
        async with self._vehicle.limited("hold", self._settings.margin_s):
            stop = self.stopping_place
            await self._send_target("hold", stop)
            await self._arrival("hold", stop, self._rests_at)

    async def _begin_turn(self, step: str, heading_deg: float) -> None:
        self._require_flying(step)
        own_rate, shortest_way, from_north = 0.0, 0.0, 0.0
        await self._vehicle.command(
            step, mavlink.MAV_CMD_CONDITION_YAW, heading_deg, own_rate, shortest_way, from_north
        )

    async def _land_in(self, step: str, mode: str, *, timeout_s: float) -> None:
        begun_s = self._vehicle.now_s
        async with self._vehicle.limited(step, timeout_s):
            await self._change_mode(step, mode)
            await self._touch_down(step, begun_s)

    async def _arrival(self, step: str, target: Position, arrived: Callable[[Position], bool]) -> None:
        """Returns on arrival; repeats the target, which may have been lost, while the vehicle comes no nearer."""
        vehicle = self._vehicle
        while not arrived(target):
            near_m = distance_m(self.position, target) - self._settings.progress_m

            def changed(near_m: float = near_m) -> bool:
                nearer = distance_m(self.position, target) <= near_m
                return arrived(target) or not vehicle.is_ours or nearer

            progress = await vehicle.happens(step, changed, within_s=self._settings.progress_s)
            vehicle.require_control(step)
            if not progress:
                await self._send_target(step, target)
            elif not self._obeys_speed or self._is_too_fast():
                await self._tell_speed(step)
                self._obeys_speed = True

    async def _send_target(self, step: str, position: Position) -> None:
        """Above the sea: a home that a ground station moves changes no target."""
        place, reposition = self._where.above_sea(position), mavlink.MAV_CMD_DO_REPOSITION
        target, latch = self._frame.position(place), self._vehicle.latch
        try:
            await self._vehicle.command_at(
                step,
                reposition,
                place,
                frame=mavlink.MAV_FRAME_GLOBAL,
                parameters=(-1.0, 0.0, 0.0, math.nan),
                expect=lambda: latch.expect_target(target),
            )
            latch.settle_target(obeyed=True)
        except AutopilotRefused as error:
            latch.settle_target(obeyed=False)
            self._vehicle.require_control(step)
            if self._vehicle.telemetry.answers.get(reposition) != mavlink.MAV_RESULT_FAILED:
                raise
            problem = f"{error.problem}, as it does to a target outside its own fence"
            raise AutopilotRefused(step, problem, error.vehicle_said) from error

    def _is_too_fast(self) -> bool:
        """Whether it still flies faster than it was told a while ago."""
        settings, now_s = self._settings, self._vehicle.now_s
        limit_m_s = self._ground_speed_m_s * settings.speed_tolerance + settings.arrival_speed_m_s
        too_fast = self._telemetry.ground_speed_m_s > limit_m_s
        return too_fast and now_s - self._told_speed_s > settings.speed_again_s

    async def _enter_guided(self, step: str) -> None:
        await self._change_mode(step, _GUIDED)
        self._obeys_speed = False

    async def _change_mode(self, step: str, mode: str) -> None:
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, _NUMBERS[mode])
        await self._vehicle.change_mode(step, parameters, (mode,))

    async def _tell_speed(self, step: str) -> None:
        self._told_speed_s = self._vehicle.now_s
        over_ground, same_throttle = mavlink.SPEED_TYPE_GROUNDSPEED, -1
        await self._vehicle.command(
            step, mavlink.MAV_CMD_DO_CHANGE_SPEED, over_ground, self._ground_speed_m_s, same_throttle
        )

    def _ask_why_not_armable(self) -> None:
        self._vehicle.question(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
