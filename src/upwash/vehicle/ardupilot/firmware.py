"""ArduCopter's side of a stand-in's connections."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.vehicle.ardupilot.boot import WARNING, Text
from upwash.vehicle.ardupilot.commands import change_mode, obey, place_of
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.dead_man import MAV_CMD_SCRIPTING, Scripting
from upwash.vehicle.ardupilot.telemetry import STREAM_GROUPS, CopterTelemetry
from upwash.vehicle.body.fence import FenceTransfer, acknowledged
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
        self._fence = CopterFenceTransfer(copter.frame, copter.fence)
        self._synchronises_s: float | None = None
        self._placed = False

    def live(self, now_s: float) -> Iterator[Message]:
        """Where its origin is, and what is wrong with it."""
        copter = self.copter
        if self._synchronises_s is None or now_s >= self._synchronises_s:
            self._synchronises_s = now_s + _TIMESYNC_S
            yield mavlink.MAVLink_timesync_message(0, round(now_s * 1e9))
        if not self._placed and copter.has_origin(now_s):
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
        """Takes modes set the old way, targets, and a fence; it has no missions and takes none."""
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

    def _hear_mission(self, now_s: float, message: Message) -> CommandReply:
        """A single item with `current` 2 is a target: older programs, DroneKit among them, steer so."""
        is_item = message.get_type() in ("MISSION_ITEM", "MISSION_ITEM_INT")
        if not is_item or message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE:
            return self._fence.hear(now_s, message)
        if message.current != 2 or message.command != mavlink.MAV_CMD_NAV_WAYPOINT:
            return acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        place = message.x * scale / 1e7, message.y * scale / 1e7, message.z
        steered = self._steer(now_s, message.frame, place)
        return acknowledged(message, mavlink.MAV_MISSION_ACCEPTED if steered else mavlink.MAV_MISSION_ERROR)


class CopterFenceTransfer(FenceTransfer):
    """As ArduCopter takes a fence: a wrong item is an error, and wrong items leave no fence."""

    most_items = 500
    request = mavlink.MAVLink_mission_request_message
    unasked = out_of_turn = mavlink.MAV_MISSION_INVALID_SEQUENCE

    def refused(self, message: Message, error: ValueError) -> CommandReply:
        """Clears the fence, and says why."""
        self.fence.set(())
        texts = Text(str(error), WARNING), Text("Fence validation failed", WARNING)
        refusal = acknowledged(message, mavlink.MAV_MISSION_ERROR)
        return replace(refusal, to_all=tuple(map(_text, texts)))


def _text(text: Text) -> Message:
    return mavlink.MAVLink_statustext_message(text.severity, text.words.encode())


_LISTENERS: dict[str, Callable[[ArduCopterFirmware, float, Message], CommandReply]] = {
    "HEARTBEAT": ArduCopterFirmware._hear_heartbeat,
    "FILE_TRANSFER_PROTOCOL": ArduCopterFirmware._hear_file_request,
    "SET_MODE": ArduCopterFirmware._hear_mode,
    "SET_POSITION_TARGET_GLOBAL_INT": ArduCopterFirmware._hear_target,
    **dict.fromkeys(
        (
            "MISSION_REQUEST_LIST",
            "MISSION_REQUEST",
            "MISSION_REQUEST_INT",
            "MISSION_CLEAR_ALL",
            "MISSION_COUNT",
            "MISSION_ITEM",
            "MISSION_ITEM_INT",
        ),
        ArduCopterFirmware._hear_mission,
    ),
}
