"""A program that flies the stand-in PX4 on virtual time, as the recordings' program flew a real one."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.vehicle.direct import directly_linked
from tests.vehicle.test_table import Client

from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.mavlink.px4 import CURRENT_MODE, Mode, bytes_of_float, event_text, float_of_bytes, understood
from upwash.sim.loop import run_virtually
from upwash.vehicle.body.connection import StandIn
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.px4.telemetry import UNASKED_S

HOME = GeoPosition(39.3666, 22.9507)
HOME_ALTITUDE_M = 488.0
SETTINGS = Px4Settings(home=HOME, home_altitude_m=HOME_ALTITUDE_M)
FRAME = LocalFrame(HOME)
GLOBAL_POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
EXTENDED_STATE = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
_NO_YAW = 1 << 10 | 1 << 11
_NO_ACCELERATION = 0b111 << 6
PLACE_ONLY = _NO_YAW | _NO_ACCELERATION | 0b111 << 3
VELOCITY_ONLY = _NO_YAW | _NO_ACCELERATION | 0b111


class Px4Client(Client):
    """Says what it likes, keeps what it hears with the time, and can stream heartbeats and setpoints."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[tuple[float, str]] = []  # events, in words
        self.changes: list[tuple[float, int, int]] = []  # mode and intended mode
        self.states: list[tuple[float, int]] = []  # landed states
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def hear(self, message: Any) -> None:
        message, now_s = understood(message), self.now_s()
        match message.get_type():
            case "EVENT" if text := event_text(message):
                self.said.append((now_s, text))
            case "CURRENT_MODE":
                modes = message.custom_mode, message.intended_custom_mode
                if not self.changes or self.changes[-1][1:] != modes:
                    self.changes.append((now_s, *modes))
            case "EXTENDED_SYS_STATE" if not self.states or self.states[-1][1] != message.landed_state:
                self.states.append((now_s, message.landed_state))
        super().hear(message)

    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    async def quietly(self) -> None:
        """Only what a test looks at, as often as the recordings hold it."""
        for number in UNASKED_S:
            await self.stream(number, every_s=-1e-6)
        await self.stream(GLOBAL_POSITION)
        await self.stream(EXTENDED_STATE)
        await self.stream(CURRENT_MODE)

    # --- streams of its own ---------------------------------------------------------------------------------

    def keep(self, name: str, message: Callable[[], Any], every_s: float) -> None:
        self.stop(name)

        async def repeat() -> None:
            while True:
                self.say(message())
                await asyncio.sleep(every_s)

        self._tasks[name] = asyncio.create_task(repeat())

    def stop(self, *names: str) -> None:
        for name in names or tuple(self._tasks):
            if task := self._tasks.pop(name, None):
                task.cancel()

    def as_ground_station(self) -> None:
        self.keep("ground station", lambda: mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 1.0)

    def as_companion(self) -> None:
        self.keep("companion", lambda: mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 1.0)

    def setpoint(self, place: Position) -> None:
        self.keep(
            "setpoints",
            lambda: mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, PLACE_ONLY, place.north_m, place.east_m, -place.altitude_m, *[0.0] * 8
            ),
            0.1,
        )

    def sticks(self, *, forward: int = 0, right: int = 0, throttle: int = 500) -> None:
        self.keep(
            "sticks", lambda: mavlink.MAVLink_manual_control_message(1, forward, right, throttle, 0, 0), 0.05
        )

    # --- commands -------------------------------------------------------------------------------------------

    async def mode(self, mode: Mode) -> list[int]:
        """The two answers."""
        known = len(self.all("COMMAND_ACK"))
        self.say(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, mode.main, mode.sub, 0, 0, 0, 0))
        await self.until(lambda: len(self.all("COMMAND_ACK")) >= known + 2)
        return [ack.result for ack in self.all("COMMAND_ACK")[known:]]

    async def armable(self) -> None:
        await asyncio.sleep(0.0)
        await self.until(lambda: (beats := self.all("HEARTBEAT")) and beats[-1].system_status == 3)

    async def arm(self) -> int:
        return await self.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    async def take_off(self, above_home_m: float = 10.0) -> None:
        """As the recordings' program: arms, takes off to an altitude above the sea, and waits for LOITER."""
        await self.quietly()
        await self.armable()
        assert await self.arm() == 0
        await self.until(lambda: self.all("HEARTBEAT")[-1].base_mode & 128)
        home_m = await self.home_altitude_m()
        nan = math.nan
        assert await self.long(22, nan, 0, 0, nan, nan, nan, home_m + above_home_m) == 0
        await self.in_mode(Mode.TAKEOFF)
        await self.in_mode(Mode.LOITER)

    async def home_altitude_m(self) -> float:
        assert await self.long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HOME_POSITION) == 0
        return float(self.all("HOME_POSITION")[-1].altitude / 1e3)

    async def reposition(self, place: Position, *, speed_m_s: float = 4.0) -> int:
        geo = FRAME.geo(place)
        x, y = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
        z = HOME_ALTITUDE_M + place.altitude_m
        self.say(mavlink.MAVLink_command_int_message(1, 1, 0, 192, 0, 0, speed_m_s, 1, 0, math.nan, x, y, z))
        return int((await self.next("COMMAND_ACK")).result)

    async def set_parameter(self, name: str, value: float) -> float:
        known = len(self.all("PARAM_VALUE"))
        sent, kind = (float_of_bytes(value), 6) if isinstance(value, int) else (value, 9)
        self.say(mavlink.MAVLink_param_set_message(1, 1, name.encode(), sent, kind))
        await self.until(lambda: len(self.all("PARAM_VALUE")) > known)
        told = self.all("PARAM_VALUE")[known]
        return float(bytes_of_float(told.param_value) if told.param_type == 6 else told.param_value)

    # --- waiting --------------------------------------------------------------------------------------------

    async def in_mode(self, mode: Mode, *, within_s: float = 120.0) -> float:
        async with asyncio.timeout(within_s):
            await self.until(lambda: self.changes and self.changes[-1][1] == mode)
        return self.now_s()

    async def in_state(self, state: int) -> float:
        await self.until(lambda: self.states and self.states[-1][1] == state)
        return self.now_s()

    async def disarmed(self) -> float:
        await self.until(lambda: not self.all("HEARTBEAT")[-1].base_mode & 128)
        return self.now_s()

    async def hears(self, text: str) -> float:
        known = len(self.said)
        await self.until(lambda: any(text in each for _, each in self.said[known:]))
        return self.now_s()

    async def says(self, text: str) -> float:
        """When it said so, be it already."""
        await self.until(lambda: any(text in each for _, each in self.said))
        return next(time_s for time_s, each in reversed(self.said) if text in each)

    def here(self) -> Position:
        report = self.all("GLOBAL_POSITION_INT")[-1]
        place = FRAME.position(GeoPosition(report.lat / 1e7, report.lon / 1e7))
        return Position(place.east_m, place.north_m, report.relative_alt / 1e3)

    def speed_m_s(self) -> float:
        report = self.all("GLOBAL_POSITION_INT")[-1]
        return math.hypot(report.vx, report.vy) / 100

    def heartbeat(self) -> tuple[int, int, int]:
        beat = self.all("HEARTBEAT")[-1]
        return beat.base_mode, beat.custom_mode, beat.system_status


def talk(scenario: Callable[[Px4Client, StandIn], Awaitable[None]], settings: Px4Settings = SETTINGS) -> None:
    """Runs it with a client on virtual time."""

    async def talked() -> None:
        client = Px4Client()
        async with AsyncExitStack() as stack:
            vehicle, client.say = await stack.enter_async_context(directly_linked(settings, client.hear))
            try:
                await scenario(client, vehicle)
            finally:
                client.stop()
                with suppress(asyncio.CancelledError):
                    await asyncio.sleep(0)

    run_virtually(talked())
