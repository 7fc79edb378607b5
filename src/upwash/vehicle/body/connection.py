"""A stand-in and its peers, in MAVLink messages. Sockets are the business of `server`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message, packed, sender_of
from upwash.mavlink.signing import Signing
from upwash.support.background import only_logged, start
from upwash.vehicle.body.copter import FaultKind, Result
from upwash.vehicle.body.firmware import StandInFirmware

_SYSTEM = 1
_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SHORTEST_INTERVAL_S = 0.01
_LONGEST_INTERVAL_US = 2**31 - 1  # that MESSAGE_INTERVAL can tell
_BEHIND_S = 1.0  # a stream that late starts again instead of catching up


class StandIn:
    """The vehicle and its peers. Its clock starts at the event loop's time and runs `speedup` times as fast."""

    def __init__(
        self, firmware: StandInFirmware[Any], speedup: float = 1.0, signing: Signing | None = None
    ) -> None:
        self.firmware = firmware
        self.signing = signing
        self.connections: set[PeerConnection] = set()
        self._loop = asyncio.get_running_loop()
        self._speedup = speedup
        self._started_s = self._loop.time()

    def now_s(self) -> float:
        """The vehicle's time."""
        return self._started_s + (self._loop.time() - self._started_s) * self._speedup

    async def sleep_until(self, time_s: float) -> None:
        """Waits until the vehicle's clock shows the time; lets other tasks run even if the time has passed."""
        await asyncio.sleep(max(0.0, (time_s - self.now_s()) / self._speedup))

    def silent(self) -> bool:
        """Whether its link is down."""
        return bool(self.firmware.copter.suffers(FaultKind.LINK, self.now_s()))

    async def live(self) -> None:
        """Sends the firmware's unrequested messages to all peers, for ever."""
        wakes_s = self.now_s()
        while True:
            now_s = self.now_s()
            self.tell_everyone(self.firmware.live(now_s))
            wakes_s = max(wakes_s + self.firmware.wakes_every_s, now_s)
            await self.sleep_until(wakes_s)

    def tell_everyone(self, messages: Iterable[Message]) -> None:
        """Sends each message to everyone whom it concerns."""
        for message in messages:
            for connection in tuple(self.connections):
                if not (isinstance(message, mavlink.MAVLink_statustext_message) and connection.spared_texts):
                    connection.send(message)


class PeerConnection:
    """A peer of the stand-in: takes its messages and sends the streams of reports that it requested."""

    def __init__(
        self, vehicle: StandIn, *, write: Callable[[bytes], None], hang_up: Callable[[], None] = lambda: None
    ) -> None:
        self.heard_s = asyncio.get_running_loop().time()
        self._vehicle = vehicle
        self._firmware = vehicle.firmware
        self._write = write
        self._hang_up = hang_up
        self._codec = mavlink.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_COMPONENT)
        self._streams: dict[float, tuple[float, asyncio.Task[None]]] = {}  # their intervals
        self._from_ground_station = False
        vehicle.connections.add(self)
        self._tell(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        for number, interval_s in self._firmware.unasked_s.items():
            self._set_interval(number, interval_s=interval_s)

    @property
    def spared_texts(self) -> bool:
        """Whether this peer gets no STATUSTEXT."""
        return self._firmware.texts_only_to_ground_stations and not self._from_ground_station

    def end(self) -> None:
        """Stops all streams and hangs up."""
        self._vehicle.connections.discard(self)
        for _, task in self._streams.values():
            task.cancel()
        self._streams.clear()
        self._hang_up()

    def send(self, message: Message) -> None:
        """Sends one message, unless the link is down."""
        data = packed(message, self._codec, self._vehicle.signing)
        if not self._vehicle.silent():
            self._write(data)

    def hear(self, message: Message) -> None:
        """Obeys a message that is addressed to the vehicle and known to it; ignores all others."""
        if self._vehicle.silent():
            return
        self.heard_s = asyncio.get_running_loop().time()
        for_system = getattr(message, "target_system", _SYSTEM)
        for_component = getattr(message, "target_component", _COMPONENT)
        if for_system not in (0, _SYSTEM) or for_component not in (0, _COMPONENT):
            return
        if message.get_type() == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_GCS:
            self._from_ground_station = True
        listener = _LISTENERS.get(message.get_type())
        if listener is not None:
            listener(self, message)
        else:
            for answer in self._firmware.hear(self._vehicle.now_s(), message):
                self.send(answer)
            self._vehicle.tell_everyone(self._firmware.said())

    # --- commands -------------------------------------------------------------------------------------------

    def _hear_command(self, message: Message) -> None:
        for result in self._obey(message):
            system, component = sender_of(message)
            self.send(
                mavlink.MAVLink_command_ack_message(
                    message.command, result, target_system=system, target_component=component
                )
            )
        # The reason of a refusal comes after the refusal: autopilots queue their texts.
        self._vehicle.tell_everyone(self._firmware.said())

    def _obey(self, message: Message) -> tuple[int, ...]:
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                done = self._set_interval(message.param1, interval_s=message.param2 / 1e6)
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                done = self._tell_interval(message.param1)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                done = self._report(self._firmware.requested(self._vehicle.now_s(), message))
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                done = self._tell(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                done = self._tell(*self._firmware.told_of_home)
            case _:
                return self._firmware.obey(self._vehicle.now_s(), message)
        return (Result.ACCEPTED if done else Result.FAILED,)

    # --- reports --------------------------------------------------------------------------------------------

    def _set_interval(self, number: float, *, interval_s: float) -> bool:
        if number not in self._firmware.reports:
            return False
        if stream := self._streams.pop(number, None):
            stream[1].cancel()
        if interval_s == 0:
            interval_s = self._firmware.unasked_s.get(int(number), 0.0)  # the default
        if 0 < interval_s < math.inf:
            every_s = max(interval_s, _SHORTEST_INTERVAL_S)
            report = self._repeat(number, every_s)
            task = start(report, name="a report of the stand-in", failed=only_logged)
            self._streams[number] = every_s, task
        return True

    async def _repeat(self, number: float, interval_s: float) -> None:
        next_s, sent = self._vehicle.now_s(), None
        while True:
            update = self._firmware.update_of(self._vehicle.now_s(), number)
            if update is None or update != sent:
                sent = update
                self._tell(number)
            next_s += interval_s
            if next_s < self._vehicle.now_s() - _BEHIND_S:
                next_s = self._vehicle.now_s()
            await self._vehicle.sleep_until(next_s)

    def _tell_interval(self, number: float) -> bool:
        if number not in self._firmware.reports:
            return False
        interval_s, _ = self._streams.get(number, (-1e-6, None))
        interval_us = min(round(interval_s * 1e6), _LONGEST_INTERVAL_US)
        self.send(mavlink.MAVLink_message_interval_message(int(number), interval_us))
        return True

    def _hear_stream_request(self, message: Message) -> None:
        wanted, known = message.req_stream_id, self._firmware.stream_groups
        groups = known.values() if wanted == mavlink.MAV_DATA_STREAM_ALL else (known.get(wanted, ()),)
        on = message.start_stop == 1 and message.req_message_rate > 0
        for group in groups:
            for number in group:
                self._set_interval(number, interval_s=1 / message.req_message_rate if on else -1.0)

    def _tell(self, *numbers: float) -> bool:
        """Sends its present reports of those numbers; whether it has any."""
        now_s = self._vehicle.now_s()
        return self._report(told for number in numbers for told in self._firmware.report(now_s, number))

    def _report(self, messages: Iterable[Message]) -> bool:
        found = False
        for message in messages:
            self.send(message)
            found = True
        return found

    def _hear_timesync(self, message: Message) -> None:
        if message.tc1 == 0:
            uptime_s = self._firmware.copter.uptime_s(self._vehicle.now_s())
            self.send(mavlink.MAVLink_timesync_message(round(uptime_s * 1e9), message.ts1))

    def _hear_version_request(self, _message: Message) -> None:
        self._tell(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    # --- parameters -----------------------------------------------------------------------------------------

    def _hear_list_request(self, _message: Message) -> None:
        for index in range(len(self._firmware.copter.parameters)):
            self.send(self._firmware.copter.parameters.at(index))

    def _hear_read_request(self, message: Message) -> None:
        parameters, index = self._firmware.copter.parameters, message.param_index
        told = parameters.named(message.param_id) if index == -1 else parameters.at(index)
        if told is not None:
            self.send(told)

    def _hear_parameter(self, message: Message) -> None:
        name = message.param_id
        said = tuple(self._firmware.set_parameter(self._vehicle.now_s(), name, message.param_value))
        if (told := self._firmware.copter.parameters.named(name)) is not None:
            self.send(told)
        self._vehicle.tell_everyone(said)


_LISTENERS: dict[str, Callable[[PeerConnection, Message], None]] = {
    "COMMAND_LONG": PeerConnection._hear_command,
    "COMMAND_INT": PeerConnection._hear_command,
    "REQUEST_DATA_STREAM": PeerConnection._hear_stream_request,
    "TIMESYNC": PeerConnection._hear_timesync,
    "AUTOPILOT_VERSION_REQUEST": PeerConnection._hear_version_request,
    "PARAM_REQUEST_LIST": PeerConnection._hear_list_request,
    "PARAM_REQUEST_READ": PeerConnection._hear_read_request,
    "PARAM_SET": PeerConnection._hear_parameter,
}
