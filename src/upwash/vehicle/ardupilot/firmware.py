"""ArduCopter's side of a stand-in's connections."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message, sender_of
from upwash.vehicle.ardupilot.commands import change_mode, obey, place_of
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.dead_man import MAV_CMD_SCRIPTING, Scripting
from upwash.vehicle.ardupilot.telemetry import STREAM_GROUPS, CopterTelemetry
from upwash.vehicle.body.fence import FenceTransfer, TransferRules, acknowledged
from upwash.vehicle.body.firmware import StandInFirmware, read_command
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
        rules = TransferRules(
            most_items=500,
            request=mavlink.MAVLink_mission_request_message,
            unasked=mavlink.MAV_MISSION_INVALID_SEQUENCE,
            out_of_turn=mavlink.MAV_MISSION_INVALID_SEQUENCE,
            refuse=copter.fence.refuse,
        )
        fence = FenceTransfer(copter.frame, copter.fence, rules, rally=copter.settings.rally)
        super().__init__(copter, self._telemetry.reports(), fence)
        self.files = Files()
        self._scripting = Scripting(copter)
        self._synchronises_s: float | None = None
        self._placed = False
        self._unsaid: list[Message] = []

    def live(self, now_s: float) -> Iterator[Message]:
        """The messages due now that nobody requested: TIMESYNC, the origin when it is first known, and texts."""
        copter = self.copter
        if self._synchronises_s is None or now_s >= self._synchronises_s:
            self._synchronises_s = now_s + _TIMESYNC_S
            yield mavlink.MAVLink_timesync_message(0, round(copter.uptime_s(now_s) * 1e9))
        if not self._placed and copter.has_origin(now_s):
            self._placed = True
            yield from self._origin(now_s)
        copter.notice(now_s)
        self._scripting.tick(now_s)
        yield from self.said()

    def said(self) -> Iterator[Message]:
        """The messages for all peers since the last call: texts, photos and origins."""
        for text in self.copter.said():
            yield mavlink.MAVLink_statustext_message(text.severity, text.words.encode())
        yield from map(self._telemetry.camera_feedback, self.copter.shots())
        unsaid, self._unsaid = self._unsaid, []
        yield from unsaid

    def obey(self, now_s: float, message: Message) -> tuple[int, ...]:
        """Carries the command out; returns the result. At arming and for a new home all peers get the origin."""
        if message.command == MAV_CMD_SCRIPTING:
            return (self._scripting.obey(message.param1, self.files),)
        was_armed, home = self.copter.armed(now_s), self.copter.home
        result = obey(self.copter, now_s, read_command(message))
        if (self.copter.armed(now_s) and not was_armed) or self.copter.home != home:
            self._unsaid += self._origin(now_s)
        return (result,)

    def _origin(self, now_s: float) -> list[Message]:
        return [message for number in self.told_of_home for message in self.report(now_s, number)]

    def _hear_mode(self, now_s: float, message: Message) -> None:
        change_mode(self.copter, now_s, base_mode=message.base_mode, mode=message.custom_mode)

    def _hear_heartbeat(self, now_s: float, message: Message) -> None:
        if message.get_srcSystem() == self.copter.parameters["MAV_GCS_SYSID"]:
            self.copter.hear_ground_station(now_s)
        self._scripting.hear(message, now_s)

    def _hear_file_request(self, now_s: float, message: Message) -> Iterable[Message]:
        sender = sender_of(message)
        answer = self.files.answer(bytes(message.payload), sender, now_s)
        if answer is not None:
            yield mavlink.MAVLink_file_transfer_protocol_message(0, *sender, list(answer))

    def _hear_target(self, now_s: float, message: Message) -> None:
        if message.type_mask & _POSITION_BITS == 0:
            place = message.lat_int / 1e7, message.lon_int / 1e7, message.alt
            self._steer(now_s, message.coordinate_frame, place)

    def _steer(self, now_s: float, frame: int, place: tuple[float, float, float]) -> bool:
        target = place_of(self.copter, frame, place)
        return target is not None and self.copter.steer(now_s, target)

    def _hear_item(self, now_s: float, message: Message) -> Iterable[Message]:
        """A single item with `current` 2 is a target: older programs, DroneKit among them, steer so."""
        if message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE:
            return self._fence.hear(now_s, message)
        if message.current != 2 or message.command != mavlink.MAV_CMD_NAV_WAYPOINT:
            return acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        place = message.x * scale / 1e7, message.y * scale / 1e7, message.z
        steered = self._steer(now_s, message.frame, place)
        return acknowledged(message, mavlink.MAV_MISSION_ACCEPTED if steered else mavlink.MAV_MISSION_ERROR)

    listeners: ClassVar = {
        "HEARTBEAT": _hear_heartbeat,
        "FILE_TRANSFER_PROTOCOL": _hear_file_request,
        "SET_MODE": _hear_mode,
        "SET_POSITION_TARGET_GLOBAL_INT": _hear_target,
        "MISSION_ITEM": _hear_item,
        "MISSION_ITEM_INT": _hear_item,
    }
