"""ArduCopter's side of a stand-in's connections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.commands import change_mode, obey, position_in_frame, read_command
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.dead_man import MAV_CMD_SCRIPTING, Scripting
from upwash.vehicle.ardupilot.fence_transfer import FenceTransfer, fence_message
from upwash.vehicle.ardupilot.telemetry import (
    REPORTS,
    STREAMS,
    camera_feedback,
    gps_global_origin,
    home_position,
)
from upwash.vehicle.body.firmware import NOTHING, Message, Reply, Report, asked_by_number
from upwash.vehicle.body.ftp import Files

_HEARTBEAT_S = 1.0
_TICK_S = 0.2  # how often it looks whether something has happened to it
_TIMESYNC_S = 10.0
_POSITION_BITS = 0b111


class ArduCopterFirmware:
    """A copter that reports, obeys and speaks as ArduCopter does."""

    stream_groups: Mapping[int, tuple[int, ...]] = STREAMS
    unasked_s: Mapping[int, float] = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: _HEARTBEAT_S}  # never changed
    told_of_home = mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION
    wakes_every_s = _TICK_S
    texts_only_to_ground_stations = False

    def __init__(self, copter: Copter) -> None:
        self.copter = copter
        self.reports: Mapping[float, Report] = {
            number: partial(report, copter) for number, report in REPORTS.items()
        }
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
        if not self._placed and copter.health.knows_its_place(now_s):
            self._placed = True
            yield from self._origin(now_s)
        yield from map(_text, copter.notice(now_s))
        self._scripting.tick(now_s)
        yield from map(_text, self._said_by_scripts)
        self._said_by_scripts.clear()

    def obey(self, now_s: float, message: Message) -> Reply:
        """Its one answer, and its reason in words; at arming, and for a new home, it tells everyone its origin."""
        if message.command == MAV_CMD_SCRIPTING:
            return Reply((self._scripting.obey(message.param1, self.files),))
        was_armed, home = self.copter.armed(now_s), self.copter.home
        answer = obey(self.copter, now_s, read_command(message))
        to_all = [_text(text) for text in answer.texts]
        to_all += [camera_feedback(self.copter, shot) for shot in self.copter.camera.told()]
        if (self.copter.armed(now_s) and not was_armed) or self.copter.home != home:
            to_all += self._origin(now_s)
        return Reply((answer.result,), to_all=tuple(to_all))

    def requested(self, now_s: float, message: Message) -> Iterable[Message]:
        """The one report of that number."""
        return asked_by_number(self.reports, now_s, message.param1)

    def hear(self, now_s: float, message: Message) -> Reply:
        """Modes set the old way, targets, a fence, and missions, of which it has none and takes none."""
        listener = _LISTENERS.get(message.get_type())
        return listener(self, now_s, message) if listener else NOTHING

    def set_parameter(self, _now_s: float, name: str, value: float) -> Iterable[Message]:
        """Changes it in silence."""
        self.copter.parameters.set(name, value)
        return ()

    def _origin(self, now_s: float) -> list[Message]:
        told = gps_global_origin(self.copter, now_s), home_position(self.copter, now_s)
        return [message for message in told if message is not None]

    def _hear_mode(self, now_s: float, message: Message) -> Reply:
        answer = change_mode(self.copter, now_s, base_mode=message.base_mode, mode=message.custom_mode)
        return Reply(to_all=tuple(map(_text, answer.texts)))

    def _hear_heartbeat(self, now_s: float, message: Message) -> Reply:
        if message.get_srcSystem() == self.copter.parameters["MAV_GCS_SYSID"]:
            self.copter.hear_ground_station(now_s)
        self._scripting.hear(message, now_s)
        return NOTHING

    def _hear_file_request(self, now_s: float, message: Message) -> Reply:
        sender = _sender(message)
        answer = self.files.answer(bytes(message.payload), sender, now_s)
        if answer is None:
            return NOTHING
        return Reply(to_sender=(mavlink.MAVLink_file_transfer_protocol_message(0, *sender, list(answer)),))

    def _hear_target(self, now_s: float, message: Message) -> Reply:
        if message.type_mask & _POSITION_BITS == 0:
            self._steer(now_s, message.coordinate_frame, message.lat_int, message.lon_int, message.alt)
        return NOTHING

    def _steer(
        self, now_s: float, frame: int, latitude_e7: float, longitude_e7: float, altitude_m: float
    ) -> bool:
        target = position_in_frame(
            self.copter,
            frame,
            latitude_deg=latitude_e7 / 1e7,
            longitude_deg=longitude_e7 / 1e7,
            altitude_m=altitude_m,
        )
        return target is not None and self.copter.steer(now_s, target)

    def _hear_mission_list_request(self, _now_s: float, message: Message) -> Reply:
        items = len(self.copter.fence.items) if _is_about_fence(message) else 0
        count = mavlink.MAVLink_mission_count_message(
            message.get_srcSystem(), message.get_srcComponent(), items, message.mission_type
        )
        return Reply(to_sender=(count,))

    def _hear_mission_item_request(self, _now_s: float, message: Message) -> Reply:
        items = self.copter.fence.items if _is_about_fence(message) else ()
        if message.seq < len(items):
            return Reply(to_sender=(fence_message(items[message.seq], message.seq, message),))
        return _acknowledged(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)

    def _hear_mission_clearing(self, _now_s: float, message: Message) -> Reply:
        if _is_about_fence(message):
            self.copter.fence.set(())
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)

    def _hear_mission_upload(self, _now_s: float, message: Message) -> Reply:
        if not _is_about_fence(message):
            return _acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        upload = self._uploads[_sender(message)] = FenceTransfer(self.copter)
        return _gone_on(upload, message, upload.begin(message.count))

    def _hear_mission_item(self, now_s: float, message: Message) -> Reply:
        """A single item with `current` 2 is a target: older programs, DroneKit among them, steer so."""
        if _is_about_fence(message):
            upload = self._uploads.setdefault(_sender(message), FenceTransfer(self.copter))
            return _gone_on(upload, message, upload.take(message))
        if message.current != 2 or message.command != mavlink.MAV_CMD_NAV_WAYPOINT:
            return _acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        steered = self._steer(now_s, message.frame, message.x * scale, message.y * scale, message.z)
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED if steered else mavlink.MAV_MISSION_ERROR)


def _is_about_fence(message: Message) -> bool:
    return bool(message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE)


def _sender(message: Message) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _gone_on(upload: FenceTransfer, message: Message, result: int | None) -> Reply:
    """Ends the upload with that result, or asks for what comes next."""
    if result is not None:
        acknowledged = _acknowledged(message, result)
        return Reply(to_sender=acknowledged.to_sender, to_all=tuple(map(_text, upload.complaint)))
    request = mavlink.MAVLink_mission_request_message(
        *_sender(message), upload.next_number, mavlink.MAV_MISSION_TYPE_FENCE
    )
    return Reply(to_sender=(request,))


def _acknowledged(message: Message, result: int) -> Reply:
    ack = mavlink.MAVLink_mission_ack_message(
        message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
    )
    return Reply(to_sender=(ack,))


def _text(text: Text) -> Message:
    return mavlink.MAVLink_statustext_message(text.severity, text.words.encode())


_LISTENERS: dict[str, Callable[[ArduCopterFirmware, float, Message], Reply]] = {
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
