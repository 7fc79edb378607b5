"""What the stand-in says and hears, in MAVLink messages, whatever carries them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position
from upwash.vehicle.clock import Clock
from upwash.vehicle.commands import change_mode, obey, position_in_frame, read_order
from upwash.vehicle.copter import Answer, Copter, Result
from upwash.vehicle.faults import FaultKind
from upwash.vehicle.parameters import Parameter
from upwash.vehicle.telemetry import (
    REPORTS,
    STREAMS,
    Message,
    Report,
    autopilot_version,
    gps_global_origin,
    heartbeat,
    home_position,
)

_SYSTEM = 1
_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_HEARTBEAT_S = 1.0
_TIMESYNC_S = 10.0
_SHORTEST_INTERVAL_S = 0.01
_BEHIND_S = 1.0  # a stream so late begins anew, instead of catching up
_POSITION_BITS = 0b111
_CRITICAL, _INFORMATION = mavlink.MAV_SEVERITY_CRITICAL, mavlink.MAV_SEVERITY_INFO


class Vehicle:
    """The copter and everyone it talks to, on its clock."""

    def __init__(self, copter: Copter, clock: Clock) -> None:
        self.copter = copter
        self.clock = clock
        self.conversations: set[Conversation] = set()

    def now_s(self) -> float:
        """The vehicle's time."""
        return self.clock.now_s()

    def silent(self) -> bool:
        """Whether its link is down."""
        return self.copter.suffers(FaultKind.LINK, self.now_s())

    async def live(self) -> None:
        """Says what it says by itself: that it is alive, where its origin is, and what is wrong with it."""
        begun_s = beat_s = self.now_s()
        sync_s, worried = begun_s, False
        placed = ready = False
        while True:
            now_s = self.now_s()
            self.tell_everyone(heartbeat)
            if now_s >= sync_s:
                self.tell_everyone(_timesync)
                sync_s = now_s + _TIMESYNC_S
            if not placed and self.copter.knows_its_place(now_s):
                placed = True
                self.tell_origin()
            if not ready and self.copter.estimates_position(now_s):
                ready = True
                self.say("EKF3 IMU0 is using GPS", _INFORMATION)
            if text := self.copter.notice(now_s):
                self.say(text)
            if self.copter.suffers(FaultKind.BATTERY, now_s) and not worried:
                self.say(f"Battery 1 is low {self.copter.battery_v(now_s):.2f}V")
            worried = self.copter.suffers(FaultKind.BATTERY, now_s)
            beat_s = max(beat_s + _HEARTBEAT_S, now_s)
            await self.clock.sleep_until(beat_s)

    def tell_origin(self) -> None:
        """Sends what everyone is told once, and again at arming."""
        self.tell_everyone(gps_global_origin)
        self.tell_everyone(home_position)

    def say(self, text: str, severity: int = _CRITICAL) -> None:
        """Tells everyone in words."""
        self.tell_everyone(
            lambda _copter, _now_s: mavlink.MAVLink_statustext_message(severity, text.encode())
        )

    def tell_everyone(self, report: Report) -> None:
        """Sends a report to everyone."""
        message = report(self.copter, self.now_s())
        for conversation in tuple(self.conversations):
            if message is not None:
                conversation.send(message)


class Conversation:
    """One peer: what it says, and the streams of reports that it asked for."""

    def __init__(
        self, vehicle: Vehicle, *, write: Callable[[bytes], None], hang_up: Callable[[], None] = lambda: None
    ) -> None:
        self.heard_s = asyncio.get_running_loop().time()
        self._vehicle = vehicle
        self._copter = vehicle.copter
        self._write = write
        self._hang_up = hang_up
        self._codec = mavlink.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_COMPONENT)
        self._streams: dict[float, _Stream] = {}
        vehicle.conversations.add(self)
        self._report(mavlink.MAVLINK_MSG_ID_HEARTBEAT)

    def end(self) -> None:
        """Stops all streams and breaks the connection off, where there is one."""
        self._vehicle.conversations.discard(self)
        for stream in self._streams.values():
            stream.end()
        self._streams.clear()
        self._hang_up()

    def send(self, message: Message) -> None:
        """Sends one message, unless the link is down."""
        data = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        if not self._vehicle.silent():
            self._write(data)

    def hear(self, message: Message) -> None:
        """Does what a message asks, if the vehicle knows it and it is meant for it."""
        if self._vehicle.silent():
            return
        self.heard_s = asyncio.get_running_loop().time()
        for_system = getattr(message, "target_system", _SYSTEM)
        for_component = getattr(message, "target_component", _COMPONENT)
        if for_system not in (0, _SYSTEM) or for_component not in (0, _COMPONENT):
            return
        listener = _LISTENERS.get(message.get_type())
        if listener is not None:
            listener(self, message)

    # --- commands -------------------------------------------------------------------------------------------

    def _hear_command(self, message: Message) -> None:
        was_armed = self._copter.armed(self._vehicle.now_s())
        answer = self._obey(message)
        self.send(
            mavlink.MAVLink_command_ack_message(
                message.command,
                answer.result,
                target_system=message.get_srcSystem(),
                target_component=message.get_srcComponent(),
            )
        )
        # ArduCopter, too, queues its texts: the reason of a refusal may come after the refusal.
        if answer.text:
            self._vehicle.say(answer.text)
        if self._copter.armed(self._vehicle.now_s()) and not was_armed:
            self._vehicle.tell_origin()

    def _obey(self, message: Message) -> Answer:
        order = read_order(message)
        match order.number:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(order.parameters[0], interval_s=order.parameters[1] / 1e6)
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                return self._tell_interval(order.parameters[0])
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._report(order.parameters[0])
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                return self._report(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                return self._report(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        return obey(self._copter, self._vehicle.now_s(), order)

    def _hear_mode(self, message: Message) -> None:
        answer = change_mode(
            self._copter, self._vehicle.now_s(), base_mode=message.base_mode, mode=message.custom_mode
        )
        if answer.text:
            self._vehicle.say(answer.text)

    # --- reports --------------------------------------------------------------------------------------------

    def _set_interval(self, number: float, *, interval_s: float) -> Answer:
        if number not in REPORTS:
            return Answer(Result.FAILED)
        if stream := self._streams.pop(number, None):
            stream.end()
        if 0 < interval_s < math.inf:
            every_s = max(interval_s, _SHORTEST_INTERVAL_S)
            self._streams[number] = _Stream(self._vehicle.clock, every_s, lambda: self._report(number))
        return Answer(Result.ACCEPTED)

    def _tell_interval(self, number: float) -> Answer:
        if number not in REPORTS:
            return Answer(Result.FAILED)
        stream = self._streams.get(number)
        interval_us = round(stream.interval_s * 1e6) if stream else -1
        self.send(mavlink.MAVLink_message_interval_message(int(number), interval_us))
        return Answer(Result.ACCEPTED)

    def _hear_stream_request(self, message: Message) -> None:
        wanted = message.req_stream_id
        groups = STREAMS.values() if wanted == mavlink.MAV_DATA_STREAM_ALL else (STREAMS.get(wanted, ()),)
        on = message.start_stop == 1 and message.req_message_rate > 0
        for group in groups:
            for number in group:
                self._set_interval(number, interval_s=1 / message.req_message_rate if on else 0.0)

    def _report(self, number: float) -> Answer:
        if number not in REPORTS:
            return Answer(Result.FAILED)
        message = REPORTS[number](self._copter, self._vehicle.now_s())
        if message is None:
            return Answer(Result.FAILED)
        self.send(message)
        return Answer(Result.ACCEPTED)

    def _hear_timesync(self, message: Message) -> None:
        if message.tc1 == 0:
            now_ns = round(self._vehicle.now_s() * 1e9)
            self.send(mavlink.MAVLink_timesync_message(now_ns, message.ts1))

    def _hear_version_request(self, _message: Message) -> None:
        self.send(autopilot_version(self._copter, self._vehicle.now_s()))

    # --- targets --------------------------------------------------------------------------------------------

    def _hear_target(self, message: Message) -> None:
        if message.type_mask & _POSITION_BITS == 0:
            self._steer(message.coordinate_frame, message.lat_int, message.lon_int, message.alt)

    def _steer(self, frame: int, latitude_e7: float, longitude_e7: float, altitude_m: float) -> bool:
        target: Position | None = position_in_frame(
            self._copter,
            frame,
            latitude_deg=latitude_e7 / 1e7,
            longitude_deg=longitude_e7 / 1e7,
            altitude_m=altitude_m,
        )
        return target is not None and self._copter.steer(self._vehicle.now_s(), target)

    # --- parameters -----------------------------------------------------------------------------------------

    def _hear_list_request(self, _message: Message) -> None:
        parameters = self._copter.parameters
        for index in range(len(parameters)):
            self._tell_parameter(parameters.at(index))

    def _hear_read_request(self, message: Message) -> None:
        parameters, index = self._copter.parameters, message.param_index
        self._tell_parameter(parameters.named(message.param_id) if index == -1 else parameters.at(index))

    def _hear_parameter(self, message: Message) -> None:
        self._copter.parameters.set(message.param_id, message.param_value)
        self._tell_parameter(self._copter.parameters.named(message.param_id))

    def _tell_parameter(self, parameter: Parameter | None) -> None:
        if parameter is not None:
            self.send(
                mavlink.MAVLink_param_value_message(
                    parameter.name.encode(),
                    parameter.value,
                    parameter.type,
                    len(self._copter.parameters),
                    parameter.index,
                )
            )

    # --- missions: it has none, and takes none --------------------------------------------------------------

    def _hear_mission_list_request(self, message: Message) -> None:
        self.send(
            mavlink.MAVLink_mission_count_message(
                message.get_srcSystem(), message.get_srcComponent(), 0, message.mission_type
            )
        )

    def _hear_mission_item_request(self, message: Message) -> None:
        self._acknowledge_mission(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)

    def _hear_mission_clearing(self, message: Message) -> None:
        self._acknowledge_mission(message, mavlink.MAV_MISSION_ACCEPTED)

    def _hear_mission_upload(self, message: Message) -> None:
        self._acknowledge_mission(message, mavlink.MAV_MISSION_UNSUPPORTED)

    def _hear_mission_item(self, message: Message) -> None:
        """A single item with `current` 2 is a target: older programs, DroneKit among them, steer so."""
        if message.current != 2 or message.command != mavlink.MAV_CMD_NAV_WAYPOINT:
            self._acknowledge_mission(message, mavlink.MAV_MISSION_UNSUPPORTED)
            return
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        steered = self._steer(message.frame, message.x * scale, message.y * scale, message.z)
        self._acknowledge_mission(
            message, mavlink.MAV_MISSION_ACCEPTED if steered else mavlink.MAV_MISSION_ERROR
        )

    def _acknowledge_mission(self, message: Message, result: int) -> None:
        self.send(
            mavlink.MAVLink_mission_ack_message(
                message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
            )
        )


_LISTENERS: dict[str, Callable[[Conversation, Message], None]] = {
    "COMMAND_LONG": Conversation._hear_command,
    "COMMAND_INT": Conversation._hear_command,
    "SET_MODE": Conversation._hear_mode,
    "SET_POSITION_TARGET_GLOBAL_INT": Conversation._hear_target,
    "REQUEST_DATA_STREAM": Conversation._hear_stream_request,
    "TIMESYNC": Conversation._hear_timesync,
    "AUTOPILOT_VERSION_REQUEST": Conversation._hear_version_request,
    "PARAM_REQUEST_LIST": Conversation._hear_list_request,
    "PARAM_REQUEST_READ": Conversation._hear_read_request,
    "PARAM_SET": Conversation._hear_parameter,
    "MISSION_REQUEST_LIST": Conversation._hear_mission_list_request,
    "MISSION_REQUEST": Conversation._hear_mission_item_request,
    "MISSION_REQUEST_INT": Conversation._hear_mission_item_request,
    "MISSION_CLEAR_ALL": Conversation._hear_mission_clearing,
    "MISSION_COUNT": Conversation._hear_mission_upload,
    "MISSION_ITEM": Conversation._hear_mission_item,
    "MISSION_ITEM_INT": Conversation._hear_mission_item,
}


class _Stream:
    """One report, again and again."""

    def __init__(self, clock: Clock, interval_s: float, report: Callable[[], object]) -> None:
        self.interval_s = interval_s
        self._task = asyncio.create_task(self._repeat(clock, report))

    def end(self) -> None:
        self._task.cancel()

    async def _repeat(self, clock: Clock, report: Callable[[], object]) -> None:
        next_s = clock.now_s()
        while True:
            report()
            next_s += self.interval_s
            if next_s < clock.now_s() - _BEHIND_S:
                next_s = clock.now_s()
            await clock.sleep_until(next_s)


def _timesync(_copter: Copter, now_s: float) -> Message:
    return mavlink.MAVLink_timesync_message(0, round(now_s * 1e9))
