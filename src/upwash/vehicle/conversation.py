"""What the stand-in says and hears, in MAVLink messages, whatever carries them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame
from upwash.vehicle.copter import Answer, Copter, Result
from upwash.vehicle.telemetry import REPORTS, Message, heartbeat, home_position

_SYSTEM = 1
_HEARTBEAT_S = 1.0
_SHORTEST_INTERVAL_S = 0.01
_POSITION_BITS = 0b111


class Vehicle:
    """The copter and everyone it talks to, on the event loop's clock."""

    def __init__(self, copter: Copter) -> None:
        self.copter = copter
        self.conversations: set[Conversation] = set()
        self._loop = asyncio.get_running_loop()

    def now_s(self) -> float:
        """The event loop's time."""
        return self._loop.time()

    async def beat(self) -> None:
        """Tells everyone that the vehicle is alive, each second."""
        while True:
            self.tell_everyone(heartbeat)
            await asyncio.sleep(_HEARTBEAT_S)

    def tell_everyone(self, report: Callable[[Copter, float], Message]) -> None:
        """Sends a report to everyone."""
        for conversation in self.conversations:
            conversation.send(report(self.copter, self.now_s()))


class Conversation:
    """One peer: what it says, and the streams of reports that it asked for."""

    def __init__(
        self, vehicle: Vehicle, *, write: Callable[[bytes], None], hang_up: Callable[[], None] = lambda: None
    ) -> None:
        self.heard_s = vehicle.now_s()
        self._vehicle = vehicle
        self._copter = vehicle.copter
        self._frame = LocalFrame(vehicle.copter.settings.home)
        self._write = write
        self._hang_up = hang_up
        self._codec = mavlink.MAVLink(None, srcSystem=_SYSTEM, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._streams: dict[float, asyncio.Task[None]] = {}
        vehicle.conversations.add(self)
        self._report(mavlink.MAVLINK_MSG_ID_HEARTBEAT)

    def end(self) -> None:
        """Stops all streams and breaks the connection off, where there is one."""
        self._vehicle.conversations.discard(self)
        for stream in self._streams.values():
            stream.cancel()
        self._streams.clear()
        self._hang_up()

    def send(self, message: Message) -> None:
        """Sends one message."""
        self._write(bytes(message.pack(self._codec)))
        self._codec.seq = (self._codec.seq + 1) % 256

    def hear(self, message: Message) -> None:
        """Does what a message asks, if the vehicle knows it and it is meant for it."""
        self.heard_s = self._vehicle.now_s()
        if getattr(message, "target_system", _SYSTEM) not in (0, _SYSTEM):
            return
        match message.get_type():
            case "COMMAND_LONG":
                self._acknowledge(message, self._obey(message))
            case "SET_MODE":
                self._copter.change_mode(self.heard_s, message.custom_mode)
            case "SET_POSITION_TARGET_GLOBAL_INT":
                self._steer(message)

    def _acknowledge(self, command: Message, answer: Answer) -> None:
        self.send(
            mavlink.MAVLink_command_ack_message(
                command.command,
                answer.result,
                target_system=command.get_srcSystem(),
                target_component=command.get_srcComponent(),
            )
        )
        # ArduCopter, too, queues its texts: the reason of a refusal may come after the refusal.
        if answer.text:
            self.send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, answer.text.encode()))

    def _obey(self, message: Message) -> Answer:
        now_s = self.heard_s
        match message.command:
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                answer = self._arm_or_disarm(message.param1)
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                answer = self._copter.take_off(now_s, message.param7)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                answer = self._copter.change_mode(now_s, mavlink.COPTER_MODE_RTL)
            case mavlink.MAV_CMD_NAV_LAND:
                answer = self._copter.change_mode(now_s, mavlink.COPTER_MODE_LAND)
            case mavlink.MAV_CMD_DO_SET_MODE:
                answer = self._copter.change_mode(now_s, message.param2)
            case mavlink.MAV_CMD_DO_CHANGE_SPEED:
                answer = self._copter.change_speed(now_s, message.param2)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                answer = self._stream(message.param1, interval_s=message.param2 / 1e6)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                answer = self._report(message.param1)
            case _:
                answer = Answer(Result.UNSUPPORTED)
        return answer

    def _arm_or_disarm(self, wish: float) -> Answer:
        if wish == 0:
            return self._copter.disarm(self.heard_s)
        if wish != 1:
            return Answer(Result.UNSUPPORTED)
        was_armed = self._copter.armed(self.heard_s)
        answer = self._copter.arm(self.heard_s)
        if answer.result is Result.ACCEPTED and not was_armed:
            self._vehicle.tell_everyone(home_position)
        return answer

    def _stream(self, number: float, *, interval_s: float) -> Answer:
        if number not in REPORTS:
            return Answer(Result.FAILED)
        if stream := self._streams.pop(number, None):
            stream.cancel()
        if interval_s > 0:
            self._streams[number] = asyncio.create_task(
                self._repeat(number, max(interval_s, _SHORTEST_INTERVAL_S))
            )
        return Answer(Result.ACCEPTED)

    async def _repeat(self, number: float, interval_s: float) -> None:
        while True:
            self._report(number)
            await asyncio.sleep(interval_s)

    def _report(self, number: float) -> Answer:
        if number not in REPORTS:
            return Answer(Result.FAILED)
        self.send(REPORTS[number](self._copter, self._vehicle.now_s()))
        return Answer(Result.ACCEPTED)

    def _steer(self, message: Message) -> None:
        positions_only = message.type_mask & _POSITION_BITS == 0
        if message.coordinate_frame != mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT or not positions_only:
            return
        target = GeoPosition(message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
        self._copter.steer(self.heard_s, self._frame.position(target))
