"""An ArduCopter at the other end of a MAVLink connection: what it reports, and commands that it answers."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotError, AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.real.mavlink import COMPANION, MavlinkLink, Message

_HEARTBEAT_S = 1.0
_LATE_TEXT_S = 0.5
_DEAD_AFTER_S = 10.0  # without any message, a connection is made anew
_STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
_COPTERS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HELICOPTER,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
)
_IN_THE_AIR = (
    mavlink.MAV_LANDED_STATE_TAKEOFF,
    mavlink.MAV_LANDED_STATE_IN_AIR,
    mavlink.MAV_LANDED_STATE_LANDING,
)
_LATE_BY = 16  # messages: what is older by its sequence number comes from a vehicle that was restarted
_TEXTS_KEPT = 16
_WILL_BE_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
_ONLY_POSITION = 0b110111111000  # of a target: no velocity, no acceleration, no yaw


@dataclass(frozen=True, slots=True)
class Patience:
    """How long the driver waits for a vehicle to say something."""

    answer_s: float = 1.0  # for the answer to a command, before it is repeated
    effect_s: float = 2.5  # for a mode or the motors to change, before they are told again
    attempts: int = 8
    quiet_after_s: float = 2.5  # without any message, the link counts as lost, and attempts no longer count
    lost_after_s: float = 10.0  # without any message, the verb in progress fails


@dataclass(slots=True)
class Telemetry:
    """What the vehicle last reported."""

    mode: int | None = None
    armed: bool = False
    landed_state: int = mavlink.MAV_LANDED_STATE_UNDEFINED
    position: GeoPosition | None = None
    speed_m_s: float = math.inf
    ground_speed_m_s: float = 0.0
    battery_percent: float | None = None
    texts: deque[str] = field(default_factory=lambda: deque(maxlen=_TEXTS_KEPT))
    texts_heard: int = 0
    answers: dict[int, int] = field(default_factory=dict)  # MAV_RESULT by MAV_CMD

    def take(self, message: Message) -> None:
        """Remembers what the message reports."""
        match message.get_type():
            case "HEARTBEAT":
                self.mode = message.custom_mode
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            case "GLOBAL_POSITION_INT" if _is_a_place(message):
                self.position = GeoPosition(message.lat / 1e7, message.lon / 1e7, message.relative_alt / 1e3)
                self.speed_m_s = math.hypot(message.vx, message.vy, message.vz) / 100
                self.ground_speed_m_s = math.hypot(message.vx, message.vy) / 100
            case "EXTENDED_SYS_STATE":
                self.landed_state = message.landed_state
            case "SYS_STATUS":
                self._take_battery(message.battery_remaining)
            case "BATTERY_STATUS" if message.id == 0:
                self._take_battery(message.battery_remaining)
            case "STATUSTEXT":
                self.texts.append(message.text)
                self.texts_heard += 1
            case "COMMAND_ACK" if message.target_component in (0, COMPANION):
                self.answers[message.command] = message.result

    def _take_battery(self, percent: int) -> None:
        self.battery_percent = float(percent) if 0 <= percent <= 100 else None  # -1: not known

    @property
    def said(self) -> str:
        """What it last said in words."""
        return self.texts[-1] if self.texts else ""

    def said_since(self, texts_heard: int) -> str:
        """All that it said after so many texts, or what it said last."""
        new = min(self.texts_heard - texts_heard, len(self.texts))
        return "; ".join(dict.fromkeys(list(self.texts)[-new:])) if new else self.said

    @property
    def on_ground(self) -> bool:
        """Whether it says that it stands on the ground."""
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def in_the_air(self) -> bool:
        """Whether it says that it has left the ground."""
        return self.landed_state in _IN_THE_AIR

    @property
    def mode_name(self) -> str:
        """The flight mode's name, for messages to people."""
        return _name("COPTER_MODE", self.mode).removeprefix("COPTER_MODE_")


class Copter:
    """The first autopilot heard on the connection; others on it are ignored.

    So is what arrives twice or late: a mode that the vehicle has left, an answer to an earlier attempt.
    """

    def __init__(self, connection: str, patience: Patience) -> None:
        self.telemetry = Telemetry()
        self._patience = patience
        self._loop = asyncio.get_running_loop()
        self._identity: tuple[int, int] | None = None  # its system and component
        self._heard_s: dict[int, float] = {}  # when, by message number
        self._sequence: int | None = None  # the number of its last message
        self._kind = (0, 0)  # its MAV_AUTOPILOT and MAV_TYPE
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
        self._require_an_arducopter()

    @property
    def linked(self) -> bool:
        """Whether the vehicle has been heard lately."""
        return self._loop.time() - self._last_heard_s < self._patience.quiet_after_s

    async def link_lost(self) -> None:
        """Returns when nothing has been heard of the vehicle for `quiet_after_s`."""
        while self.linked:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(self._last_heard_s + self._patience.quiet_after_s):
                    await self._news.wait()

    async def link_restored(self) -> None:
        """Returns when the vehicle is heard, at once if it is."""
        while not self.linked:
            await self._news.wait()

    def heard_since(self, number: int, time_s: float) -> bool:
        """Whether the message of that number has come since then."""
        return self._heard_s.get(number, -math.inf) >= time_s

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
        texts_heard = self.telemetry.texts_heard
        attempt = 0
        while attempt < self._patience.attempts:
            self._send_command(command, parameters, confirmation=attempt)
            if await self.happens(step, lambda: command in answers, within_s=self._patience.answer_s):
                break
            if self.linked:
                attempt += 1
        else:
            raise AutopilotTimeout(
                step,
                f"no answer to {_name('MAV_CMD', command)} after {attempt} attempts",
                self.telemetry.said,
            )
        if answers[command] not in _WILL_BE_DONE:
            await self.happens(step, lambda: self.telemetry.texts_heard > texts_heard, within_s=_LATE_TEXT_S)
            problem = (
                f"the vehicle answered {_name('MAV_RESULT', answers[command])} to {_name('MAV_CMD', command)}"
            )
            raise AutopilotRefused(step, problem, self.telemetry.said_since(texts_heard))

    async def change_mode(self, step: str, mode: int) -> None:
        """Returns when the vehicle reports the mode."""
        await self._effect(
            step,
            lambda: self.telemetry.mode == mode,
            mavlink.MAV_CMD_DO_SET_MODE,
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            mode,
        )

    async def arm(self, step: str, *, armed: bool) -> None:
        """Returns when the vehicle reports that its motors run, or that they stand still."""
        await self._effect(
            step, lambda: self.telemetry.armed == armed, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, armed
        )

    async def _effect(self, step: str, done: Callable[[], bool], command: int, *parameters: float) -> None:
        """Commands until the vehicle reports that it did so: its yes may have been to an earlier attempt."""
        for _ in range(self._patience.attempts):
            await self.command(step, command, *parameters)
            self._ask_for_heartbeat()
            if await self.happens(step, done, within_s=self._patience.effect_s):
                return
        raise AutopilotTimeout(
            step, f"{_name('MAV_CMD', command)} was accepted and not done", self.telemetry.said
        )

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

    def _hear(self, message: Message) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if self._identity is None and _from_autopilot(message):
            self._identity = sender
            self._kind = message.autopilot, message.type
            self._link.speak_as_part_of(message.get_srcSystem())
            self._ask_for_missing_streams()
        if sender != self._identity or self._is_late(message.get_seq()):
            return
        self._sequence = message.get_seq()
        self._last_heard_s = self._heard_s[message.get_msgId()] = self._loop.time()
        self.telemetry.take(message)
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _is_late(self, sequence: int) -> bool:
        """Whether a message is one that was heard already, or older; after a silence anything is news."""
        return self._sequence is not None and self.linked and (self._sequence - sequence) % 256 <= _LATE_BY

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
            self._leave_a_dead_connection()
            await asyncio.sleep(_HEARTBEAT_S)

    def _ask_for_missing_streams(self) -> None:
        """Asks at the start, and again where a request was lost or the autopilot was restarted."""
        if self._identity is None:
            return
        horizon_s = self._loop.time() - self._patience.quiet_after_s
        for number, rate_hz in _STREAMS_HZ.items():
            if self._heard_s.get(number, -math.inf) < horizon_s:
                self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (number, 1e6 / rate_hz))

    def _leave_a_dead_connection(self) -> None:
        """A peer that vanished without a word leaves a connection behind on which nothing ever comes."""
        last_sign_s = max(self._last_heard_s, self._link.opened_s)
        if self._loop.time() - last_sign_s > _DEAD_AFTER_S:
            self._link.reopen()

    def _require_an_arducopter(self) -> None:
        autopilot, kind = self._kind
        if autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA or kind not in _COPTERS:
            raise AutopilotError(
                "connect",
                f"{_name('MAV_AUTOPILOT', autopilot)} with {_name('MAV_TYPE', kind)} was heard on "
                f"{self._link.connection}; only an ArduCopter can be flown: its modes have other numbers elsewhere",
            )

    def _silence(self) -> str:
        trouble = f" ({self._link.trouble})" if self._link.trouble else ""
        return f"nothing was heard on {self._link.connection} for {self._patience.lost_after_s:g} s{trouble}"


def _from_autopilot(message: Message) -> bool:
    if message.get_type() != "HEARTBEAT" or message.get_srcSystem() == 0:
        return False
    return bool(message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def _is_a_place(message: Message) -> bool:
    """Whether the position is one on the Earth; 0, 0 says that it is not known yet."""
    latitude_e7, longitude_e7 = message.lat, message.lon
    known = (latitude_e7, longitude_e7) != (0, 0)
    return bool(known and abs(latitude_e7) <= 90e7 and abs(longitude_e7) <= 180e7)


def _name(enum: str, number: int | None) -> str:
    entry = mavlink.enums[enum].get(number)
    return entry.name if entry else f"number {number}"
