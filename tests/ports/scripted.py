"""A vehicle of single messages: a test says what it reports, and sees what the driver sends to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AT_ONCE, HOME

from upwash.core.geo import LocalFrame, Position, Velocity
from upwash.mavlink.packets import PacketReader
from upwash.mavlink.px4 import CURRENT_MODE, CurrentModeMessage, Mode
from upwash.mavlink.signing import Signing
from upwash.ports import VehicleNews
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, connect_autopilot

FRAME = LocalFrame(HOME)
SYSTEM, HOME_ABOVE_SEA_M = 7, 488.0
ON_GROUND, IN_AIR = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR


class Script:
    """An ArduCopter that sends a heartbeat each second, accepts all, and changes its mode and arming."""

    firmware, always_has = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "FRAME_CLASS"
    own_mode: int = mavlink.COPTER_MODE_GUIDED
    signing: Signing | None = None
    version: int | None = 4 << 24 | 6 << 16 | 255
    autopilot: MavlinkAutopilot  # which has found it

    def __init__(self, *, armed: bool) -> None:
        self.mode = self.own_mode
        self.armed = armed
        self.lists: dict[int, list[Any]] = {}  # the items of each MAV_MISSION_TYPE
        self.parameters = {self.always_has: 1.0}  # the others are missing
        self.tells_after_s: dict[str, float] = {}  # by parameter; the others at once
        self.mute = False
        self.obeys = True
        self.results: dict[
            int, int | None
        ] = {}  # MAV_RESULT by command: ACCEPTED by default, None for no answer
        self.sent: list[tuple[float, Any]] = []  # by the driver, with the time
        self.news: list[VehicleNews] = []
        self._codec = mavlink.MAVLink(None, SYSTEM, 1)
        self._line: Any = None

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    async def open(self, line: Any) -> None:
        self._line, line.write = line, self._hear

    async def live(self) -> None:
        while True:
            if self._line is not None and not self.mute:
                await self.say(self.heartbeat())
            await asyncio.sleep(1.0)

    def heartbeat(self) -> Any:
        base_mode = 81 | (128 if self.armed else 0)
        return mavlink.MAVLink_heartbeat_message(2, self.firmware, base_mode, self.mode, 4, 3)

    async def say(self, *messages: Any) -> None:
        """Sends messages of the vehicle; returns once the driver has them."""
        for message in messages:
            self._line.datagram_received(self._packed(message), ("", 1))
            self._codec.seq = (self._codec.seq + 1) % 256
        await asyncio.sleep(0)
        await asyncio.sleep(0)

    async def beat(self, *, armed: bool | None = None, mode: int | None = None) -> None:
        """Sends a heartbeat at once."""
        self.armed = self.armed if armed is None else armed
        self.mode = self.mode if mode is None else mode
        await self.say(self.heartbeat())

    def place(self, place: Position, velocity: Velocity = Velocity(), *, heading_deg: float = 0.0) -> Any:  # noqa: B008
        """The report of a place, by its height above home."""
        geo = FRAME.geo(place)
        return mavlink.MAVLink_global_position_int_message(
            round(self.now_s * 1e3),
            round(geo.latitude_deg * 1e7),
            round(geo.longitude_deg * 1e7),
            round((HOME_ABOVE_SEA_M + place.altitude_m) * 1e3),
            round(place.altitude_m * 1e3),
            vx=round(velocity.north_m_s * 100),
            vy=round(velocity.east_m_s * 100),
            vz=round(-velocity.up_m_s * 100),
            hdg=round(heading_deg * 100),
        )

    async def resumed(self, place: Position) -> None:
        """It flies there in the program's mode, armed from the start, and the program has it."""
        await self.say(landed(IN_AIR), self.place(place))
        await self.autopilot.claim(resumes=True)

    def of_kind(self, kind: str, since_s: float = 0.0) -> list[Any]:
        return [message for at_s, message in self.sent if message.get_type() == kind and at_s >= since_s]

    def commands(self, number: int, since_s: float = 0.0) -> list[Any]:
        kinds = "COMMAND_LONG", "COMMAND_INT"
        return [
            message
            for at_s, message in self.sent
            if message.get_type() in kinds and message.command == number and at_s >= since_s
        ]

    def asked_for(self, number: int) -> list[float]:
        """When the driver asked for one report of that number."""
        request = mavlink.MAV_CMD_REQUEST_MESSAGE
        return [
            at_s
            for at_s, message in self.sent
            if getattr(message, "command", None) == request and message.param1 == number
        ]

    def _hear(self, data: bytes) -> None:
        for message, _ in PacketReader().read(data):
            self.sent.append((self.now_s, message))
            if not self.mute:
                asyncio.get_running_loop().call_soon(self._answer, message)

    def _answer(self, message: Any) -> None:
        answers: list[Any] = []
        match message.get_type():
            case "PARAM_REQUEST_READ" if message.param_id in self.parameters:
                value, real = self.parameters[message.param_id], mavlink.MAV_PARAM_TYPE_REAL32
                told_value = mavlink.MAVLink_param_value_message(message.param_id.encode(), value, real, 1, 0)
                asyncio.get_running_loop().call_later(
                    self.tells_after_s.get(message.param_id, 0.0), self._send, [told_value]
                )
            case "MISSION_REQUEST_LIST":
                kind = message.mission_type
                answers = [
                    mavlink.MAVLink_mission_count_message(255, 191, len(self.lists.get(kind, ())), kind)
                ]
            case "MISSION_REQUEST_INT":
                answers = [self.lists[message.mission_type][message.seq]]
            case "COMMAND_LONG" if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
                told = self.told()
                answers = [told[message.param1]] if message.param1 in told else []
            case "COMMAND_LONG" | "COMMAND_INT":
                result = self.results.get(message.command, mavlink.MAV_RESULT_ACCEPTED)
                self._obey(message, result)
                if result is not None:
                    answers = [
                        mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, SYSTEM, 191)
                    ]
        self._send(answers)

    def _obey(self, message: Any, result: int | None) -> None:
        if result != mavlink.MAV_RESULT_ACCEPTED or not self.obeys:
            return
        if message.command == mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = self.mode_set_by(message)
        elif message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = bool(message.param1)

    def told(self) -> dict[int, Any]:
        """The reports that it sends when it is asked for one."""
        told = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: self.heartbeat()}
        if self.version is not None:
            numbers = [0] * 8
            told[mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION] = mavlink.MAVLink_autopilot_version_message(
                0, self.version, 0, 0, 0, numbers, numbers, numbers, 0, 0, 1
            )
        return told

    def mode_set_by(self, message: Any) -> int:
        return int(message.param2)

    def _packed(self, message: Any) -> bytes:
        return self.signing.pack(message, self._codec) if self.signing else bytes(message.pack(self._codec))

    def _send(self, answers: list[Any]) -> None:
        for answer in answers:
            self._line.datagram_received(self._packed(answer), ("", 1))
            self._codec.seq = (self._codec.seq + 1) % 256


class Px4Script(Script):
    """A PX4 of the same manners."""

    firmware, always_has, own_mode = mavlink.MAV_AUTOPILOT_PX4, "SYS_AUTOSTART", Mode.LOITER
    intends = 0  # a mode other than the flown one, in a fail-safe

    def mode_set_by(self, message: Any) -> int:
        return int(message.param2) << 16 | int(message.param3) << 24

    def told(self) -> dict[int, Any]:
        intends = self.intends or self.mode
        mode = CurrentModeMessage(custom_mode=self.mode, intended_custom_mode=intends, standard_mode=0)
        return {**super().told(), CURRENT_MODE: mode}

    def _obey(self, message: Any, result: int | None) -> None:
        super()._obey(message, result)
        if self.obeys and message.command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self.mode = Mode.TAKEOFF


def landed(state: int) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(0, state)


@asynccontextmanager
async def scripted(
    settings: FlightSettings = AT_ONCE,
    *,
    armed: bool = False,
    ground_speed_m_s: float = 5.0,
    kind: type[Script] = Script,
    system: int | None = None,
) -> AsyncIterator[Script]:
    """A vehicle of single messages, and the driver that has found it."""
    script = kind(armed=armed)
    life = asyncio.create_task(script.live())
    script.autopilot = await connect_autopilot(
        script.open, frame=FRAME, ground_speed_m_s=ground_speed_m_s, settings=settings, system=system
    )
    script.autopilot.listen(script.news.append)
    try:
        yield script
    finally:
        await script.autopilot.close()
        life.cancel()
