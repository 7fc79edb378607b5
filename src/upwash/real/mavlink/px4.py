"""A PX4, steered in OFFBOARD along a course of setpoints (docs/decisions/px4.md)."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.way_home import PX4 as PX4_WAY_HOME
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.errors import AutopilotError, AutopilotRefused
from upwash.mavlink.px4 import RUN_PREARM_CHECKS
from upwash.ports import VehicleLimits
from upwash.real.mavlink.autopilot import MavlinkAutopilot, check_speed
from upwash.real.mavlink.course import Course
from upwash.real.mavlink.fence_settings import PX4_FENCE, px4_limits
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.needs import require_current_mode
from upwash.real.mavlink.offboard import SetpointStream
from upwash.real.mavlink.parameters import read_parameters
from upwash.real.mavlink.px4_firmware import (
    LAND,
    LOITER,
    LOITER_STATE,
    MODES,
    OFFBOARD,
    RTL,
    TAKEOFF,
    failsafe,
    words_of,
)
from upwash.real.mavlink.px4_settings import check_settings, failsafe_delay_s
from upwash.real.mavlink.quantities import read_quantities
from upwash.real.mavlink.way_home import PX4_QUANTITIES, px4_abilities, px4_energy

_POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_LEAST_BLOCKING = (
    mavlink.MAV_SEVERITY_ERROR
)  # a failed check that is less severe does not keep it from being armed
_FRESH_WITHIN_S = 0.5
_BEFORE_OFFBOARD_S = 0.6  # PX4 looks at whether setpoints come twice a second
_MODE_WITHIN_S = 1.5
_ENDS_BELOW_M = 2.0  # a take-off to 10 m ended 0.5 to 1.2 m below it
_LEAST_CLIMB_M, _UP_M = (
    4.0,
    0.5,
)  # so that OFFBOARD comes before the end of the lowest take-off, and in the air
_TAKES_OVER_S = 1.2  # from when OFFBOARD is wanted until it is there
_MEAN_OVER_S = 1.0  # of its velocity: hovering, it reports 0.28 m/s in the median, and 0.6 m/s at times
_SETTLES_S = 1.0  # more than COM_FAIL_ACT_T


class Px4(MavlinkAutopilot):
    """In OFFBOARD from the end of its take-off on: a mode that somebody else sets is seen, and setpoints keep it."""

    return_mode, land_mode = RTL, LAND

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._stream = SetpointStream(self._vehicle, self._where)
        self._velocities: deque[tuple[float, Velocity]] = deque()
        self._listening.enter_context(self._vehicle.listening(self._hear_position))
        self._energy = EnergyFacts(way_home=PX4_WAY_HOME)
        self._holds = False

    async def close(self) -> None:
        """Leaves it hovering where it was told to hold: without setpoints, OFFBOARD ends in COM_OBL_RC_ACT."""
        try:
            if self._holds and self._stream.course is not None and self._vehicle.is_ours:
                with contextlib.suppress(AutopilotError):
                    await self._change_mode("leave hovering", LOITER)
        finally:
            await self._stream.close()
            await super().close()

    # --- before the flight ----------------------------------------------------------------------------------

    async def claim(self, *, resumes: bool) -> None:
        """Waits where a fail-safe has only begun: PX4 hovers for some seconds before it acts."""
        if resumes and self._telemetry.armed and failsafe(self._telemetry, ""):
            wait_s = await failsafe_delay_s(self._vehicle) + _SETTLES_S
            await self._vehicle.happens("start", lambda: self._vehicle.mode_name != LOITER, within_s=wait_s)
        await super().claim(resumes=resumes)

    async def inspect(self) -> None:
        """Looks whether its firmware reports what is needed, and at what it would do without the program."""
        await super().inspect()
        await require_current_mode(self._vehicle)
        await check_settings(self._vehicle)

    async def limits(self) -> VehicleLimits:
        """Home, and what its parameters and its fence list say."""
        limits = await super().limits()
        await self.learn()
        told = await read_parameters(self._vehicle, (*PX4_FENCE, "COM_OBL_RC_ACT"))
        limits = replace(limits, returns_at_m=self._energy.return_altitude_m)
        return await px4_limits(self._vehicle, self._frame, limits, told)

    async def learn(self) -> None:
        """Its energy facts, and what it can do."""
        told = await read_quantities(self._vehicle, PX4_QUANTITIES)
        self._energy, self._stream.abilities = px4_energy(told), px4_abilities(told)

    @property
    def energy(self) -> EnergyFacts:
        """By its parameters, once `limits` has read them; by PX4's own defaults until then."""
        return replace(self._energy, home=super().energy.home)

    async def arm(self) -> None:
        """In AUTO.LOITER; tries again while its last checks object."""
        vehicle, settings = self._vehicle, self._settings
        deadline_s = vehicle.now_s + settings.ready_timeout_s
        async with vehicle.limited("arm", settings.ready_timeout_s + settings.margin_s):
            await self._change_mode("arm", LOITER)
            while True:
                begun_s = vehicle.now_s
                try:
                    await self._make_sure_of_mode("arm")
                    await vehicle.arm("arm", armed=True)
                    break
                except AutopilotRefused:
                    vehicle.require_control("arm")
                    if vehicle.now_s + settings.arm_again_s > deadline_s:
                        raise
                    self._tell_delay(self._reasons_since(begun_s))
                await asyncio.sleep(settings.arm_again_s)
            await self._while_ours("arm", lambda: self._telemetry.position is not None)

    # --- in the air -----------------------------------------------------------------------------------------

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs in AUTO.TAKEOFF, and in OFFBOARD before that ends in Hold, which a pilot may choose, too."""
        step = f"takeoff to {altitude_m:g} m"
        async with self._vehicle.limited(step, self._vertical_s(altitude_m)):
            if not self._telemetry.armed:
                raise AutopilotRefused(step, "the vehicle is not armed; nothing was sent")
            begun_s = self._vehicle.now_s  # home moves until the motors run
            await self._while_ours(step, lambda: self._vehicle.heard_since(_POSITION, begun_s))
            self._where.fix_ground()
            here, top_m = self.position, max(altitude_m, _LEAST_CLIMB_M)
            await self._lift_off(step, self._where.above_sea(here.at_altitude(top_m)).altitude_m)
            await self._while_ours(step, lambda: self._nears(top_m))
            course = await self._enter_offboard(step)
            course.aim(here.at_altitude(altitude_m), ground_speed_m_s=self._ground_speed_m_s)
            await self._while_ours(step, lambda: course.ended and self._climbed(altitude_m))

    def _nears(self, top_m: float) -> bool:
        """Whether its take-off may end by itself before OFFBOARD has it, unless that begins now."""
        climb_m_s = self._telemetry.velocity.up_m_s if self._telemetry.velocity else 0.0
        from_m = max(_UP_M, top_m - _ENDS_BELOW_M - _TAKES_OVER_S * climb_m_s)
        return self._telemetry.in_the_air and self.position.altitude_m >= from_m

    async def _lift_off(self, step: str, above_sea_m: float) -> None:
        nan = math.nan  # where it stands, headed as it is
        parameters = (-1.0, 0.0, 0.0, nan, nan, nan, above_sea_m)
        await self._until_mode(
            step, TAKEOFF, mavlink.MAV_CMD_NAV_TAKEOFF, parameters, lambda: self._telemetry.in_the_air
        )

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """The course's, from the next leg on."""
        check_speed(ground_speed_m_s)
        self._ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Straight there."""
        step = f"goto {position.east_m:.1f} m east, {position.north_m:.1f} m north"
        self._require_flying(step)
        async with self._vehicle.limited(step, self._leg_s(position)):
            course = await self._enter_offboard(step)
            self._stream.heading_deg = None
            course.aim(position, ground_speed_m_s=self._ground_speed_m_s)
            await self._while_ours(step, lambda: course.ended and self._arrived(position))

    async def _begin_turn(self, step: str, heading_deg: float) -> None:
        self._require_flying(step)
        await self._enter_offboard(step)
        self._stream.heading_deg = heading_deg

    @property
    def stopping_place(self) -> Position:
        """Where its course would, which is ahead of it."""
        course = self._stream.course
        return self.position if course is None else course.stopping_place

    async def hold(self) -> None:
        """Brakes, and stays where that ends."""
        self._require_flying("hold")
        async with self._vehicle.limited("hold", self._settings.margin_s):
            course = await self._enter_offboard("hold")
            course.stop()
            await self._while_ours("hold", lambda: course.ended and self._rests_at(course.position))
            self._holds = True

    async def _land_in(self, step: str, mode: str, *, timeout_s: float) -> None:
        begun_s = self._vehicle.now_s
        self._require_flying(step)
        async with self._vehicle.limited(step, timeout_s):
            await self._change_mode(step, mode)
            await self._touch_down(step, begun_s)

    # --- modes ----------------------------------------------------------------------------------------------

    async def _enter_offboard(self, step: str) -> Course:
        """Has it follow the course from now on: one from where it is, unless it follows one already."""
        vehicle, stream = self._vehicle, self._stream
        vehicle.require_control(step)
        self._holds = False
        if stream.course is not None and vehicle.mode_name == OFFBOARD:
            return stream.course
        await self._make_sure_of_mode(step)
        vehicle.latch.expect_modes((OFFBOARD,))  # where setpoints were lost, they alone have it go there
        stream.begin().stop()
        await vehicle.happens(step, lambda: not vehicle.is_ours, within_s=_BEFORE_OFFBOARD_S)
        try:
            await self._change_mode(step, OFFBOARD)
        except BaseException:
            if vehicle.mode_name != OFFBOARD:
                stream.end()
            raise
        return stream.begin()  # from where it is by now

    async def _change_mode(self, step: str, mode: str) -> None:
        number = MODES[mode]
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, number.main, number.sub)
        await self._until_mode(step, mode, mavlink.MAV_CMD_DO_SET_MODE, parameters)
        if mode != OFFBOARD:
            self._stream.end()

    async def _until_mode(
        self,
        step: str,
        mode: str,
        command: int,
        parameters: Sequence[float],
        done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Commands until the vehicle reports the mode, or that it is done, whatever it answers.

        Of its two answers to DO_SET_MODE, the first is always yes.
        """
        vehicle = self._vehicle
        padded = (*parameters, *[0.0] * (7 - len(parameters)))

        def message(system: int, component: int) -> Message:
            return mavlink.MAVLink_command_long_message(system, component, command, 0, *padded)

        for _ in range(vehicle.patience.attempts):
            await self._make_sure_of_mode(step)
            begun_s = vehicle.now_s
            vehicle.latch.expect_modes((mode,))
            if vehicle.mode_name == mode:
                return
            vehicle.steer(step, message)
            if await self._turns_true(
                step, lambda: vehicle.mode_name == mode or done(), within_s=_MODE_WITHIN_S
            ):
                return
        vehicle.latch.withdraw()
        said = self._telemetry.said_since(begun_s)
        raise AutopilotRefused(step, f"the vehicle does not enter {mode}, it is in {vehicle.mode_name}", said)

    async def _turns_true(self, step: str, condition: Callable[[], bool], *, within_s: float) -> bool:
        """Whether it does, by reports that are asked for; AutopilotOverruled where the vehicle is lost first."""
        vehicle = self._vehicle
        until_s = vehicle.now_s + within_s
        while not condition() and vehicle.now_s < until_s:
            vehicle.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            await vehicle.happens(
                step, lambda: condition() or not vehicle.is_ours, within_s=min(_FRESH_WITHIN_S, within_s)
            )
            vehicle.require_control(step)
        return condition()

    async def _make_sure_of_mode(self, step: str) -> None:
        """Returns once it has told its mode anew and is still ours: heartbeats come but once a second."""
        vehicle = self._vehicle
        asked_s = vehicle.now_s
        while not vehicle.heard_since(mavlink.MAVLINK_MSG_ID_HEARTBEAT, asked_s):
            vehicle.require_control(step)
            vehicle.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            await vehicle.happens(
                step,
                lambda: vehicle.heard_since(mavlink.MAVLINK_MSG_ID_HEARTBEAT, asked_s),
                within_s=_FRESH_WITHIN_S,
            )
        vehicle.require_control(step)

    # --- what it reports ------------------------------------------------------------------------------------

    def _may_be_armed(self) -> bool:
        """By its checks for AUTO.LOITER, whatever mode it is in."""
        telemetry = self._telemetry
        if self._vehicle.mode_name != LOITER:
            telemetry.can_be_armed = bool((telemetry.armable_modes or 0) & LOITER_STATE)
        return super()._may_be_armed()

    def _reasons_since(self, _since_s: float) -> tuple[str, ...]:
        """What the last set of failed checks holds against arming in AUTO.LOITER."""
        blocking = (
            words_of(number)
            for number, (severity, modes) in self._telemetry.failed_checks.items()
            if modes & LOITER_STATE and severity <= _LEAST_BLOCKING
        )
        return tuple(dict.fromkeys(blocking))

    def _ask_why_not_armable(self) -> None:
        self._vehicle.question(RUN_PREARM_CHECKS)

    def _hear_position(self, message: Message) -> None:
        velocity = self._telemetry.velocity
        if message.get_type() != "GLOBAL_POSITION_INT" or velocity is None:
            return
        now_s = self._vehicle.now_s
        self._velocities.append((now_s, velocity))
        while self._velocities[0][0] < now_s - _MEAN_OVER_S:
            self._velocities.popleft()

    def _at_rest(self) -> bool:
        """By the mean of its velocities: what it reports of a hover is mostly noise."""
        velocities = [velocity for _, velocity in self._velocities]
        if not velocities:
            return False
        east_m_s = sum(each.east_m_s for each in velocities)
        north_m_s = sum(each.north_m_s for each in velocities)
        up_m_s = sum(each.up_m_s for each in velocities)
        return math.hypot(east_m_s, north_m_s, up_m_s) / len(velocities) < self._settings.arrival_speed_m_s
