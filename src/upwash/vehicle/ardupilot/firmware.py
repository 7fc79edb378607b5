"""ArduCopter's side of a stand-in's connections."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.commands import change_mode, obey, place_of
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.dead_man import MAV_CMD_SCRIPTING, Scripting
from upwash.vehicle.ardupilot.fence_transfer import FenceTransfer, fence_message
from upwash.vehicle.ardupilot.telemetry import STREAM_GROUPS, CopterTelemetry
from upwash.vehicle.body.firmware import (
    NOTHING,
    CommandReply,
    Message,
    StandInFirmware,
    read_command,
    sender_of,
)
from upwash.vehicle.body.ftp import Files

_TIMESYNC_S = 10.0
_POSITION_BITS = 0b111


class ArduCopterFirmware(StandInFirmware[Copter]):
    """A copter that reports, obeys and speaks as ArduCopter does."""

    stream_groups = STREAM_GROUPS
    unasked_s: ClassVar = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
    told_of_home = mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION
    wakes_every_s = 0.2

    def __init__(self, copter: Copter) -> None:
        self._telemetry = CopterTelemetry(copter)
        super().__init__(copter, self._telemetry.reports())
        self.files = Files()
        self._said_by_scripts: list[Text] = []
        self._scripting = Scripting(copter, self._said_by_scripts.append)
        self._uploads: dict[tuple[int, int], FenceTransfer] = {}  # of fences, by who sends them
        self._synchronises_s: float | None = None
        self._placed = False

    def live(self, now_s: float) -> Iterator[Message]:
        """Where its origin is, and what is wrong with it."""
        copter = self.copter
        if self._synchronises_s is None or now_s >= self._synchronises_s:
            self._synchronises_s = now_s + _TIMESYNC_S
            yield mavlink.MAVLink_timesync_message(0, round(now_s * 1e9))
        if not self._placed and copter.knows_its_place(now_s):
            self._placed = True
            yield from self._origin(now_s)
        yield from map(_text, copter.notice(now_s))
        self._scripting.tick(now_s)
        yield from map(_text, self._said_by_scripts)
        self._said_by_scripts.clear()

    def obey(self, now_s: float, message: Message) -> CommandReply:
        """Its one answer, and its reason in words; at arming, and for a new home, it tells everyone its origin."""
        if message.command == MAV_CMD_SCRIPTING:
            return CommandReply((self._scripting.obey(message.param1, self.files),))
        was_armed, home = self.copter.armed(now_s), self.copter.home
        answer = obey(self.copter, now_s, read_command(message))
        to_all = [_text(text) for text in answer.texts]
        to_all += map(self._telemetry.camera_feedback, self.copter.shots())
        if (self.copter.armed(now_s) and not was_armed) or self.copter.home != home:
            to_all += self._origin(now_s)
        return CommandReply((answer.result,), to_all=tuple(to_all))

    def hear(self, now_s: float, message: Message) -> CommandReply:
        """Modes set the old way, targets, a fence, and missions, of which it has none and takes none."""
        listener = _LISTENERS.get(message.get_type())
        return listener(self, now_s, message) if listener else NOTHING

    def _origin(self, now_s: float) -> list[Message]:
        return [message for number in self.told_of_home for message in self.report(now_s, number)]

    def _hear_mode(self, now_s: float, message: Message) -> CommandReply:
        answer = change_mode(self.copter, now_s, base_mode=message.base_mode, mode=message.custom_mode)
        return CommandReply(to_all=tuple(map(_text, answer.texts)))

    def _hear_heartbeat(self, now_s: float, message: Message) -> CommandReply:
        if message.get_srcSystem() == self.copter.parameters["MAV_GCS_SYSID"]:
            self.copter.hear_ground_station(now_s)
        self._scripting.hear(message, now_s)
        return NOTHING

    def _hear_file_request(self, now_s: float, message: Message) -> CommandReply:
        sender = sender_of(message)
        answer = self.files.answer(bytes(message.payload), sender, now_s)
        if answer is None:
            return NOTHING
        return CommandReply(
            to_sender=(mavlink.MAVLink_file_transfer_protocol_message(0, *sender, list(answer)),)
        )

    def _hear_target(self, now_s: float, message: Message) -> CommandReply:
        if message.type_mask & _POSITION_BITS == 0:
            place = message.lat_int / 1e7, message.lon_int / 1e7, message.alt
            self._steer(now_s, message.coordinate_frame, place)
        return NOTHING

    def _steer(self, now_s: float, frame: int, place: tuple[float, float, float]) -> bool:
        target = place_of(self.copter, frame, place)
        return target is not None and self.copter.steer(now_s, target)

    def _hear_mission_list_request(self, _now_s: float, message: Message) -> CommandReply:
        items = len(self.copter.fence.items) if _is_about_fence(message) else 0
        count = mavlink.MAVLink_mission_count_message(*sender_of(message), items, message.mission_type)
        return CommandReply(to_sender=(count,))

    def _hear_mission_item_request(self, _now_s: float, message: Message) -> CommandReply:
        items = self.copter.fence.items if _is_about_fence(message) else ()
        if message.seq < len(items):
            return CommandReply(to_sender=(fence_message(items[message.seq], message.seq, message),))
        return _acknowledged(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)

    def _hear_mission_clearing(self, _now_s: float, message: Message) -> CommandReply:
        if _is_about_fence(message):
            self.copter.fence.set(())
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)

    def _hear_mission_upload(self, _now_s: float, message: Message) -> CommandReply:
        if not _is_about_fence(message):
            return _acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        upload = self._uploads[sender_of(message)] = FenceTransfer(self.copter)
        return _gone_on(upload, message, upload.begin(message.count))

    def _hear_mission_item(self, now_s: float, message: Message) -> CommandReply:
        """A single item with `current` 2 is a target: older programs, DroneKit among them, steer so."""
        if _is_about_fence(message):
            upload = self._uploads.setdefault(sender_of(message), FenceTransfer(self.copter))
            return _gone_on(upload, message, upload.take(message))
        if message.current != 2 or message.command != mavlink.MAV_CMD_NAV_WAYPOINT:
            return _acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        place = message.x * scale / 1e7, message.y * scale / 1e7, message.z
        steered = self._steer(now_s, message.frame, place)
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED if steered else mavlink.MAV_MISSION_ERROR)


def _is_about_fence(message: Message) -> bool:
    return bool(message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE)


def _gone_on(upload: FenceTransfer, message: Message, result: int | None) -> CommandReply:
    """Ends the upload with that result, or asks for what comes next."""
    if result is not None:
        acknowledged = _acknowledged(message, result)
        return CommandReply(to_sender=acknowledged.to_sender, to_all=tuple(map(_text, upload.complaint)))
    request = mavlink.MAVLink_mission_request_message(
        *sender_of(message), upload.next_number, mavlink.MAV_MISSION_TYPE_FENCE
    )
    return CommandReply(to_sender=(request,))


def _acknowledged(message: Message, result: int) -> CommandReply:
    ack = mavlink.MAVLink_mission_ack_message(*sender_of(message), result, message.mission_type)
    return CommandReply(to_sender=(ack,))


def _text(text: Text) -> Message:
    return mavlink.MAVLink_statustext_message(text.severity, text.words.encode())


_LISTENERS: dict[str, Callable[[ArduCopterFirmware, float, Message], CommandReply]] = {
    "HEARTBEAT": ArduCopterFirmware._hear_heartbeat,
    "FILE_TRANSFER_PROTOCOL": ArduCopterFirmware._hear_file_request,
    "SET_MODE": ArduCopterFirmware._hear_mode,
    "SET_POSITION_TARGET_GLOBAL_INT": ArduCopterFirmware._hear_target,
    "MISSION_REQUEST_LIST": ArduCopterFirmware._hear_mission_list_request,
    "MISSION_REQUEST": ArduCopterFirmware._hear_mission_item_request,
    "MISSION_REQUEST_INT": ArduCopterFirmware._hear_mission_item_request,
    "MISSION_CLEAR_ALL": ArduCopterFirmware._hear_mission_clearing,
    "MISSION_COUNT": ArduCopterFirmware._hear_mission_upload,
    "MISSION_ITEM": ArduCopterFirmware._hear_mission_item,
    "MISSION_ITEM_INT": ArduCopterFirmware._hear_mission_item,
}
