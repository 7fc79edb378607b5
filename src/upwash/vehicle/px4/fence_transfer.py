"""The stand-in PX4's fence over MAVLink's mission protocol: items are asked for in turn, and taken all or none."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, GeoPosition
from upwash.vehicle.body.firmware import NOTHING, CommandReply, Message
from upwash.vehicle.px4.fence import Disc, Fence, Vertex, assembled
from upwash.vehicle.px4.vehicle import Quadrotor

_ASKS_AGAIN_S = 0.25
_MOST_FENCE_ITEMS = 100
_FENCE_CORNERS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_FENCE_CIRCLES = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}


class FenceTransfer:
    """The fence that it has, and one on its way in."""

    def __init__(self, copter: Quadrotor) -> None:
        self._copter = copter
        self._items: list[Message] = []
        self._upload: _Upload | None = None

    def hear(self, now_s: float, message: Message) -> CommandReply:
        """Takes a message of the mission protocol; any other is none of its business."""
        listener = _LISTENERS.get(message.get_type())
        return listener(self, now_s, message) if listener else NOTHING

    def missing(self, now_s: float) -> Iterator[Message]:
        """Asks once more for an item that has not come."""
        if self._upload and now_s >= self._upload.asked_s + _ASKS_AGAIN_S:
            yield self._upload.request(now_s)

    def _hear_list_request(self, _now_s: float, message: Message) -> CommandReply:
        count = len(self._items) if message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE else 0
        return CommandReply(
            to_sender=(
                mavlink.MAVLink_mission_count_message(
                    message.get_srcSystem(), message.get_srcComponent(), count, message.mission_type
                ),
            )
        )

    def _hear_item_request(self, _now_s: float, message: Message) -> CommandReply:
        fence = message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE
        if not (fence and message.seq < len(self._items)):
            return _acknowledged(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)
        item = self._items[message.seq]
        return CommandReply(
            to_sender=(
                mavlink.MAVLink_mission_item_int_message(
                    message.get_srcSystem(),
                    message.get_srcComponent(),
                    message.seq,
                    item.frame,
                    item.command,
                    0,
                    0,
                    item.param1,
                    item.param2,
                    item.param3,
                    item.param4,
                    item.x,
                    item.y,
                    item.z,
                    mission_type=mavlink.MAV_MISSION_TYPE_FENCE,
                ),
            )
        )

    def _hear_clearing(self, _now_s: float, message: Message) -> CommandReply:
        if message.mission_type in (mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_ALL):
            self._items, self._copter.fence = [], Fence()
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)

    def _hear_count(self, now_s: float, message: Message) -> CommandReply:
        if message.mission_type != mavlink.MAV_MISSION_TYPE_FENCE:
            return _acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
        if message.count > _MOST_FENCE_ITEMS:
            return _acknowledged(message, mavlink.MAV_MISSION_NO_SPACE)
        if message.count == 0:
            return self._hear_clearing(now_s, message)
        self._upload = _Upload(message)
        return CommandReply(to_sender=(self._upload.request(now_s),))

    def _hear_item(self, now_s: float, message: Message) -> CommandReply:
        upload = self._upload
        if upload is None or message.mission_type != mavlink.MAV_MISSION_TYPE_FENCE:
            return _acknowledged(message, mavlink.MAV_MISSION_ERROR)
        if message.get_srcSystem() != upload.system or message.seq != len(upload.items):
            return NOTHING  # of somebody else, or once more
        upload.items.append(message)
        if len(upload.items) < upload.count:
            return CommandReply(to_sender=(upload.request(now_s),))
        self._upload = None
        read = [self._read(item) for item in upload.items]
        fence = assembled([item for item in read if item is not None])
        if fence is None or None in read:
            return _acknowledged(message, mavlink.MAV_MISSION_INVALID)
        self._items, self._copter.fence = upload.items, fence
        return _acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)

    def _read(self, item: Message) -> Vertex | Disc | None:
        if item.get_type() == "MISSION_ITEM":
            latitude_deg, longitude_deg = item.x, item.y
        else:
            latitude_deg, longitude_deg = item.x / 1e7, item.y / 1e7
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and math.isfinite(item.param1)):
            return None
        place = self._copter.frame.position(GeoPosition(latitude_deg, longitude_deg))
        if item.command in _FENCE_CORNERS:
            return Vertex(place, int(item.param1), _FENCE_CORNERS[item.command])
        if item.command in _FENCE_CIRCLES:
            return Disc(Circle(place, item.param1), _FENCE_CIRCLES[item.command])
        return None


class _Upload:
    """A fence on its way in: the items so far, each asked for in turn."""

    def __init__(self, message: Message) -> None:
        self.system, self.component = message.get_srcSystem(), message.get_srcComponent()
        self.count = int(message.count)
        self.items: list[Message] = []
        self.asked_s = -math.inf

    def request(self, now_s: float) -> Message:
        """Asks for the next item."""
        self.asked_s = now_s
        return mavlink.MAVLink_mission_request_int_message(
            self.system, self.component, len(self.items), mavlink.MAV_MISSION_TYPE_FENCE
        )


def _acknowledged(message: Message, result: int) -> CommandReply:
    ack = mavlink.MAVLink_mission_ack_message(
        message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
    )
    return CommandReply(to_sender=(ack,))


_LISTENERS: dict[str, Callable[[FenceTransfer, float, Message], CommandReply]] = {
    "MISSION_REQUEST_LIST": FenceTransfer._hear_list_request,
    "MISSION_REQUEST": FenceTransfer._hear_item_request,
    "MISSION_REQUEST_INT": FenceTransfer._hear_item_request,
    "MISSION_CLEAR_ALL": FenceTransfer._hear_clearing,
    "MISSION_COUNT": FenceTransfer._hear_count,
    "MISSION_ITEM": FenceTransfer._hear_item,
    "MISSION_ITEM_INT": FenceTransfer._hear_item,
}
