"""The driver of a PX4, steered in OFFBOARD along a course of setpoints (docs/decisions/px4.md)."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, distance_m
from upwash.core.vehicle.course import SetpointCourse
from upwash.core.vehicle.return_place import RallyPoints
from upwash.core.vehicle.way_home import PX4 as PX4_WAY_HOME
from upwash.errors import AutopilotError, AutopilotRefused
from upwash.mavlink.packets import Message
from upwash.ports import ComingDown, VehicleLimits
from upwash.real.mavlink.autopilot import MavlinkAutopilot
from upwash.real.mavlink.fence import PX4_FENCE, px4_limits
from upwash.real.mavlink.needs import check_px4_settings, px4_failsafe_delay_s, require_current_mode
from upwash.real.mavlink.parameters import read_parameters, read_quantities
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
from upwash.real.mavlink.rally import RallySite, px4_rally
from upwash.real.mavlink.setpoints import SetpointStream
from upwash.real.mavlink.way_home import PX4_QUANTITIES, px4_abilities, px4_ends, px4_energy

_POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_LEAST_BLOCKING = mavlink.MAV_SEVERITY_ERROR  # a less severe failed check does not keep it from being armed
_FRESH_WITHIN_S = 0.5
_BEFORE_OFFBOARD_S = 0.6  # PX4 checks twice a second whether setpoints come
_MODE_WITHIN_S = 1.5
_ENDS_BELOW_M = 2.0  # a take-off to 10 m ended 0.5 to 1.2 m below it
_LEAST_CLIMB_M, _UP_M = 4.0, 0.5  # OFFBOARD comes before the end of the lowest take-off, and in the air
_TAKES_OVER_S = 1.2  # from the request for OFFBOARD until the mode
_STANDS_OVER_S, _LEAST_STANDS_S = 1.0, 0.5  # the times between two places that show whether it moves
_SETTLES_S = 1.0  # more than COM_FAIL_ACT_T


class Px4Autopilot(MavlinkAutopilot):
    """The autopilot of a PX4.

    It flies in OFFBOARD from the end of its take-off, so that a mode set by a pilot or another program shows in
    reports.
    """

    return_mode, land_mode, usual_way_home = RTL, LAND, PX4_WAY_HOME

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._stream = SetpointStream(self.vehicle, self._tracker)
        self._places: deque[tuple[float, Position]] = deque()
        self._listening.enter_context(self.vehicle.listening(self._hear_position))
        self._holds = False

    async def close(self) -> None:
        """Closes the driver; after a hold the vehicle hovers in LOITER, as OFFBOARD ends without setpoints."""
        try:
            if self._holds and self._stream.course is not None and self.vehicle.is_ours:
                with contextlib.suppress(AutopilotError):
                    await self._change_mode("leave hovering", LOITER)
        finally:
            await self._stream.close()
            await super().close()

    # --- before the flight ----------------------------------------------------------------------------------

    async def claim(self, *, resumes: bool, ordered: ComingDown | None = None) -> None:
        """Claims the vehicle, after the end of a fail-safe's delay: PX4 hovers for some seconds before it acts."""
        if resumes and self._telemetry.armed and failsafe(self._telemetry, ""):
            wait_s = await px4_failsafe_delay_s(self.vehicle) + _SETTLES_S
            await self.vehicle.happens("start", lambda: self.vehicle.mode_name != LOITER, within_s=wait_s)
        await super().claim(resumes=resumes, ordered=ordered)

    async def inspect(self) -> None:
        """Checks the firmware's reports and its settings for the loss of the program; raises AutopilotRefused."""
        await super().inspect()
        await require_current_mode(self.vehicle)
        await check_px4_settings(self.vehicle)

    async def learn(self) -> None:
        """Reads the battery's stages, the way home and the greatest speeds from the vehicle's parameters."""
        values = await read_quantities(self.vehicle, PX4_QUANTITIES)
        self._energy, self._stream.abilities = px4_energy(values), px4_abilities(values)
        for setting in px4_ends(values):
            self.vehicle.news.tell(setting)

    async def _rally(self, site: RallySite) -> RallyPoints:
        return await px4_rally(self.vehicle, site)

    async def _fenced(self, limits: VehicleLimits) -> VehicleLimits:
        parameters = await read_parameters(self.vehicle, PX4_FENCE)
        return await px4_limits(self.vehicle, self._frame, limits, parameters)

    def _may_be_armed(self) -> bool:
        """Whether the vehicle's checks for AUTO.LOITER pass, in any mode."""
        telemetry = self._telemetry
        if self.vehicle.mode_name != LOITER:
            telemetry.can_be_armed = bool((telemetry.armable_modes or 0) & LOITER_STATE)
        return super()._may_be_armed()

    def _reasons_since(self, _since_s: float) -> tuple[str, ...]:
        """The failed checks of the last set that block arming in AUTO.LOITER."""
        blocking = (
            words_of(number)
            for number, (severity, modes) in self._telemetry.failed_checks.items()
            if modes & LOITER_STATE and severity <= _LEAST_BLOCKING
        )
        return tuple(dict.fromkeys(blocking))

    # --- in the air -----------------------------------------------------------------------------------------

    async def _climb(self, step: str, altitude_m: float) -> None:
        """Climb in AUTO.TAKEOFF, and enter OFFBOARD before that ends in Hold, a mode that a pilot may choose, too."""
        if not self._telemetry.armed:
            raise AutopilotRefused(step, "the vehicle is not armed; nothing was sent")
        begun_s = self.vehicle.now_s  # home moves until the motors run
        await self._while_ours(step, lambda: self.vehicle.heard_since(_POSITION, begun_s))
        self._tracker.fix_ground()
        here, top_m = self.position, max(altitude_m, _LEAST_CLIMB_M)
        above_sea_m = self._tracker.above_sea(here.at_altitude(top_m)).altitude_m
        nan = math.nan  # where it stands, headed as it is
        parameters = (-1.0, 0.0, 0.0, nan, nan, nan, above_sea_m)
        await self._until_mode(
            step, TAKEOFF, mavlink.MAV_CMD_NAV_TAKEOFF, parameters, lambda: self._telemetry.in_the_air
        )
        await self._while_ours(step, lambda: self._nears(top_m))
        course = await self._enter_offboard(step)
        course.aim(here.at_altitude(altitude_m), ground_speed_m_s=self._ground_speed_m_s)
        await self._while_ours(step, lambda: course.ended and self._climbed(altitude_m))

    def _nears(self, top_m: float) -> bool:
        """Whether OFFBOARD must be requested now, before the take-off ends by itself."""
        climb_m_s = self._telemetry.velocity.up_m_s if self._telemetry.velocity else 0.0
        from_m = max(_UP_M, top_m - _ENDS_BELOW_M - _TAKES_OVER_S * climb_m_s)
        return self._telemetry.in_the_air and self.position.altitude_m >= from_m

    async def _fly_to(self, step: str, position: Position) -> None:
        self._require_flying(step)
        course = await self._enter_offboard(step)
        self._stream.look_at(position)
        course.aim(position, ground_speed_m_s=self._ground_speed_m_s)
        await self._while_ours(step, lambda: course.ended and self._arrived(position))

    async def _begin_turn(self, step: str, heading_deg: float) -> None:
        await self._enter_offboard(step)
        self._stream.heading_deg = heading_deg

    @property
    def stopping_place(self) -> Position:
        """Where the vehicle would come to rest if it braked now: the course's stopping place."""
        course = self._stream.course
        return self.position if course is None else course.stopping_place

    async def _stop(self) -> None:
        """Brake, and stay where the vehicle comes to rest; from 8 m/s it overshoots by 2 m, and creeps back."""
        self._require_flying("hold")
        course = await self._enter_offboard("hold")
        course.stop()
        await self._while_ours("hold", lambda: course.ended and self._at_rest())
        self._holds = True

    async def _land_in(self, step: str, mode: str, *, timeout_s: float) -> None:
        self._require_flying(step)
        await super()._land_in(step, mode, timeout_s=timeout_s)

    # --- modes ----------------------------------------------------------------------------------------------

    async def _enter_offboard(self, step: str) -> SetpointCourse:
        """Make the vehicle follow a course, and return it: a new one from here, unless it follows one already."""
        vehicle, stream = self.vehicle, self._stream
        vehicle.require_control(step)
        self._holds = False
        if stream.course is not None and vehicle.mode_name == OFFBOARD:
            return stream.course
        await vehicle.confirm_control(step)
        vehicle.latch.expect_modes((OFFBOARD,))  # after their loss, setpoints alone have it go there
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
        """Repeat the command until the vehicle reports the mode, or `done` is true; its answers do not count.

        PX4 answers DO_SET_MODE twice, and the first answer is always yes.
        """
        vehicle = self.vehicle
        for _ in range(vehicle.patience.attempts):
            await vehicle.confirm_control(step)
            begun_s = vehicle.now_s
            vehicle.latch.expect_modes((mode,))
            if vehicle.mode_name == mode:
                return
            vehicle.steer(step, vehicle.command_long(command, *parameters))
            if await self._is_reported(step, lambda: vehicle.mode_name == mode or done()):
                return
        vehicle.latch.withdraw()
        said = self._telemetry.said_since(begun_s)
        raise AutopilotRefused(step, f"the vehicle does not enter {mode}, it is in {vehicle.mode_name}", said)

    async def _is_reported(self, step: str, condition: Callable[[], bool]) -> bool:
        """Ask for reports until the condition is true; AutopilotOverruled if the vehicle is lost before."""
        vehicle = self.vehicle
        until_s = vehicle.now_s + _MODE_WITHIN_S
        while not condition() and vehicle.now_s < until_s:
            vehicle.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            await vehicle.happens(step, lambda: condition() or not vehicle.is_ours, within_s=_FRESH_WITHIN_S)
            vehicle.require_control(step)
        return condition()

    # --- whether it moves -----------------------------------------------------------------------------------

    def _hear_position(self, message: Message) -> None:
        if message.get_type() != "GLOBAL_POSITION_INT":
            return
        now_s = self.vehicle.now_s
        self._places.append((now_s, self._tracker.position))
        while self._places[0][0] < now_s - _STANDS_OVER_S:
            self._places.popleft()

    def _at_rest(self) -> bool:
        """Whether its place has hardly changed in a second: its velocity can be off by 0.6 m/s for seconds."""
        if not self._places:
            return False
        (from_s, start), (until_s, end) = self._places[0], self._places[-1]
        passed_s = until_s - from_s
        at_most_m = self._settings.arrival_speed_m_s * passed_s
        return passed_s >= _LEAST_STANDS_S and distance_m(start, end) < at_most_m
