"""An ArduCopter at the other end of a MAVLink connection: what it reports, and commands that it answers."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotError, AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.real.mavlink import COMPANION, MavlinkLink, Message

_HEARTBEAT_S = 1.0
_LATE_TEXT_S = 0.5
_STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
}
_WILL_BE_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
_ONLY_POSITION = 0b110111111000  # of a target: no velocity, no acceleration, no yaw


@dataclass(frozen=True, slots=True)
class Patience:
    """How long the driver waits for a vehicle to say something."""

    answer_s: float = 1.0  # for the answer to a command, before it is repeated
    attempts: int = 5
    quiet_after_s: float = 3.0  # without any message, attempts no longer count
    lost_after_s: float = 10.0  # without any message, the verb in progress fails


@dataclass(slots=True)
class Telemetry:
    """What the vehicle last reported."""

    mode: int | None = None
    armed: bool = False
    on_ground: bool = False
    position: GeoPosition | None = None
    speed_m_s: float = math.inf
    said: str = ""
    answers: dict[int, int] = field(default_factory=dict)  # MAV_RESULT by MAV_CMD

    def take(self, message: Message) -> None:
        """Remembers what the message reports."""
        match message.get_type():
            case "HEARTBEAT":
                self.mode = message.custom_mode
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            case "GLOBAL_POSITION_INT" if (message.lat, message.lon) != (0, 0):  # 0, 0: not known yet
                self.position = GeoPosition(message.lat / 1e7, message.lon / 1e7, message.relative_alt / 1e3)
                self.speed_m_s = math.hypot(message.vx, message.vy, message.vz) / 100
            case "EXTENDED_SYS_STATE":
                self.on_ground = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
            case "STATUSTEXT":
                self.said = message.text
            case "COMMAND_ACK" if message.target_component in (0, COMPANION):
                self.answers[message.command] = message.result

    @property
    def mode_name(self) -> str:
        """The flight mode's name, for messages to people."""
        return _name("COPTER_MODE", self.mode).removeprefix("COPTER_MODE_")


class Copter:
    """The first autopilot heard on the connection; others on it are ignored."""

    def __init__(self, connection: str, patience: Patience) -> None:
        self.telemetry = Telemetry()
        self._patience = patience
        self._loop = asyncio.get_running_loop()
        self._identity: tuple[int, int] | None = None  # its system and component
        self._heard_s: dict[int, float] = {}  # when, by message number
        self._last_heard_s = self._loop.time()
        self._news = asyncio.Event()
        self._link = MavlinkLink(connection, self._hear)
        self._accompanying = asyncio.create_task(self._accompany())

    async def found(self, *, within_s: float) -> None:
        """Returns when the vehicle's heartbeat has been heard; raises AutopilotError if it is not."""
        try:
            async with asyncio.timeout(within_s):
                while self._identity is None:
                    await self._news.wait()
        except TimeoutError:
            trouble = f" ({self._link.trouble})" if self._link.trouble else ""
            raise AutopilotError(
                "connect",
                f"no autopilot was heard on {self._link.connection} within {within_s:g} s{trouble}; check that it is "
                "powered, that the address or device and its speed are right, and that no other program holds it",
            ) from None

    async def close(self) -> None:
        """Gives up the connection."""
        self._accompanying.cancel()
        await asyncio.gather(self._accompanying, return_exceptions=True)
        await self._link.close()

    async def until(self, step: str, condition: Callable[[], bool]) -> None:
        """Returns when the condition, looked at with each message, is true; raises AutopilotLost on silence."""
        while not condition():
            try:
                async with asyncio.timeout_at(self._last_heard_s + self._patience.lost_after_s):
                    await self._news.wait()
            except TimeoutError:
                raise AutopilotLost(step, self._silence(), self.telemetry.said) from None

    async def happens(self, step: str, condition: Callable[[], bool], *, within_s: float) -> bool:
        """Whether the condition comes true within the time."""
        try:
            async with asyncio.timeout(within_s):
                await self.until(step, condition)
        except TimeoutError:
            return False
        return True

    async def command(self, step: str, command: int, *parameters: float) -> None:
        """Returns when the vehicle has said yes; raises AutopilotRefused, or AutopilotTimeout if it says nothing."""
        answers = self.telemetry.answers
        answers.pop(command, None)
        asked_s = self._loop.time()
        attempt = 0
        while attempt < self._patience.attempts:
            self._send_command(command, parameters, confirmation=attempt)
            if await self.happens(step, lambda: command in answers, within_s=self._patience.answer_s):
                break
            if not self._quiet():
                attempt += 1
        else:
            raise AutopilotTimeout(
                step,
                f"no answer to {_name('MAV_CMD', command)} after {attempt} attempts",
                self.telemetry.said,
            )
        if answers[command] not in _WILL_BE_DONE:
            await self._late_text(step, asked_s)
            problem = (
                f"the vehicle answered {_name('MAV_RESULT', answers[command])} to {_name('MAV_CMD', command)}"
            )
            raise AutopilotRefused(step, problem, self.telemetry.said)

    async def change_mode(self, step: str, mode: int) -> None:
        """Returns when the vehicle reports the mode."""
        await self.command(step, mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode)
        self._ask_for_heartbeat()
        await self.until(step, lambda: self.telemetry.mode == mode)

    async def arm(self, step: str, *, armed: bool) -> None:
        """Returns when the vehicle reports that its motors run, or that they stand still."""
        await self.command(step, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, armed)
        self._ask_for_heartbeat()
        await self.until(step, lambda: self.telemetry.armed == armed)

    def send_target(self, target: GeoPosition) -> None:
        """Tells the vehicle where to fly; it does not answer, and only listens in GUIDED."""
        system, component = self._identity or (0, 0)
        self._link.send(
            mavlink.MAVLink_set_position_target_global_int_message(
                time_boot_ms=0,
                target_system=system,
                target_component=component,
                coordinate_frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
                type_mask=_ONLY_POSITION,
                lat_int=round(target.latitude_deg * 1e7),
                lon_int=round(target.longitude_deg * 1e7),
                alt=target.altitude_m,
                vx=0,
                vy=0,
                vz=0,
                afx=0,
                afy=0,
                afz=0,
                yaw=0,
                yaw_rate=0,
            )
        )

    def _ask_for_heartbeat(self) -> None:
        """The mode and the motors' state come by HEARTBEAT, which is up to a second late by itself."""
        self._send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))

    def _send_command(self, command: int, parameters: tuple[float, ...], *, confirmation: int = 0) -> None:
        system, component = self._identity or (0, 0)
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self._link.send(
            mavlink.MAVLink_command_long_message(system, component, command, confirmation, *padded)
        )

    async def _late_text(self, step: str, asked_s: float) -> None:
        """Waits a moment for the reason of a refusal, which ArduPilot may send after the refusal."""
        await self.happens(
            step,
            lambda: self._heard_s.get(mavlink.MAVLINK_MSG_ID_STATUSTEXT, -math.inf) >= asked_s,
            within_s=_LATE_TEXT_S,
        )

    def _hear(self, message: Message) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if self._identity is None and _from_autopilot(message):
            self._identity = sender
            self._link.speak_as_part_of(message.get_srcSystem())
            self._ask_for_missing_streams()
        if sender != self._identity:
            return
        self._last_heard_s = self._heard_s[message.get_msgId()] = self._loop.time()
        self.telemetry.take(message)
        news, self._news = self._news, asyncio.Event()
        news.set()

    async def _accompany(self) -> None:
        """Heartbeats as a companion computer: as a ground station it would hide the loss of the real one."""
        while True:
            await self._link.opened.wait()
            self._link.send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    base_mode=0,
                    custom_mode=0,
                    system_status=mavlink.MAV_STATE_ACTIVE,
                    mavlink_version=3,
                )
            )
            self._ask_for_missing_streams()
            await asyncio.sleep(_HEARTBEAT_S)

    def _ask_for_missing_streams(self) -> None:
        """Asks at the start, and again where a request was lost or the autopilot was restarted."""
        if self._identity is None:
            return
        horizon_s = self._loop.time() - self._patience.quiet_after_s
        for number, rate_hz in _STREAMS_HZ.items():
            if self._heard_s.get(number, -math.inf) < horizon_s:
                self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (number, 1e6 / rate_hz))

    def _quiet(self) -> bool:
        return self._loop.time() - self._last_heard_s > self._patience.quiet_after_s

    def _silence(self) -> str:
        trouble = f" ({self._link.trouble})" if self._link.trouble else ""
        return f"nothing was heard on {self._link.connection} for {self._patience.lost_after_s:g} s{trouble}"


def _from_autopilot(message: Message) -> bool:
    return bool(message.get_type() == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def _name(enum: str, number: int | None) -> str:
    entry = mavlink.enums[enum].get(number)
    return entry.name if entry else f"number {number}"
