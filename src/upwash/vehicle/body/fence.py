"""The areas of a stand-in's fence, and MAVLink's mission protocol that brings them: taken all or none.

Rally points can be read by it, too; they are set when the stand-in is switched on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, GeoPosition, LocalFrame, Position
from upwash.core.vehicle.geofence import Fence, Polygon
from upwash.mavlink.packets import Message, sender_of

_POLYGONS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}
_FEWEST_CORNERS = 3
_FENCE, _RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY


@dataclass(frozen=True, slots=True)
class FenceItem:
    """An item of a fence as it was uploaded: a circle, or a corner of a polygon with `number` corners.

    Or a rally point, whose place has an altitude above home.
    """

    command: int
    number: float
    place: Position
    latitude_e7: int
    longitude_e7: int


class UploadedFence:
    """The items of a fence, and the areas that they describe."""

    def __init__(self) -> None:
        self.items: tuple[FenceItem, ...] = ()
        self.areas: tuple[Fence, ...] = ()

    def set(self, items: tuple[FenceItem, ...]) -> None:
        """Takes a new fence; ValueError where the items describe none."""
        self.areas = tuple(_areas(items))
        self.items = items


def _areas(items: Sequence[FenceItem]) -> Iterator[Fence]:
    left = list(items)
    while left:
        first = left[0]
        if not math.isfinite(first.number):
            raise ValueError(f"Invalid vertex count ({first.number})")
        if first.command in _CIRCLES and first.number > 0:
            yield Fence("a circle", Circle(first.place, first.number), _CIRCLES[first.command])
            left = left[1:]
            continue
        count = int(first.number)
        corners = left[:count]
        alike = all((item.command, item.number) == (first.command, first.number) for item in corners)
        if first.command not in _POLYGONS or not _FEWEST_CORNERS <= count == len(corners) or not alike:
            raise ValueError(f"Invalid vertex count ({count})")
        polygon = Polygon(tuple(item.place for item in corners))
        yield Fence("a polygon", polygon, _POLYGONS[first.command])
        left = left[count:]


@dataclass(slots=True)
class _Upload:
    """An upload: the items up to now, and the time of the request for the next item."""

    sender: tuple[int, int]
    count: int
    items: list[FenceItem] = field(default_factory=list)
    asked_s: float = -math.inf
    leaves_earth: bool = False


@dataclass(frozen=True, slots=True)
class TransferRules:
    """How an autopilot takes a fence.

    `request` is its message that asks for an item, once more after `asks_again_s`. `unasked` is the
    MAV_MISSION_RESULT for an item without an upload, `out_of_turn` for one of another sender or with another number.
    `refuse` gets what is wrong with an upload, and returns the result of that.
    """

    most_items: int
    request: Any
    unasked: int
    out_of_turn: int | None
    refuse: Callable[[str], int]
    asks_again_s: float = math.inf


class FenceTransfer:
    """A fence over the mission protocol: one upload at a time, with a request for each item in turn."""

    def __init__(
        self,
        frame: LocalFrame,
        fence: UploadedFence,
        rules: TransferRules,
        *,
        rally: Sequence[GeoPosition] = (),
    ) -> None:
        self._fence = fence
        self._rally = [_rally_item(frame, place) for place in rally]
        self._frame = frame
        self._rules = rules
        self._upload: _Upload | None = None

    def hear(self, now_s: float, message: Message) -> tuple[Message, ...]:
        """Takes a message of the mission protocol; any other is none of its business."""
        about_fence = getattr(message, "mission_type", None) == _FENCE
        match message.get_type():
            case "MISSION_REQUEST_LIST":
                count, kind = len(self._kept(message)), message.mission_type
                return _to_sender(message, mavlink.MAVLink_mission_count_message, count, kind)
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                if message.seq < len(kept := self._kept(message)):
                    return (_item(kept[message.seq], message),)
                return acknowledged(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)
            case "MISSION_CLEAR_ALL":
                if about_fence or message.mission_type == mavlink.MAV_MISSION_TYPE_ALL:
                    self._fence.set(())
                return acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)
            case "MISSION_COUNT":
                if not about_fence:
                    return acknowledged(message, mavlink.MAV_MISSION_UNSUPPORTED)
                return self._begin(now_s, message)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                return self._take(now_s, message, about_fence=about_fence)
        return ()

    def missing(self, now_s: float) -> tuple[Message, ...]:
        """Asks once more for an item that has not come."""
        late = self._upload is not None and now_s >= self._upload.asked_s + self._rules.asks_again_s
        return (self._ask(now_s, self._upload),) if self._upload and late else ()

    def _kept(self, message: Message) -> Sequence[FenceItem]:
        """The items of the list that the message is about."""
        if message.mission_type == _RALLY:
            return self._rally
        return self._fence.items if message.mission_type == _FENCE else ()

    def _begin(self, now_s: float, message: Message) -> tuple[Message, ...]:
        self._upload = None
        if message.count > self._rules.most_items:
            return acknowledged(message, mavlink.MAV_MISSION_NO_SPACE)
        if message.count == 0:
            self._fence.set(())
            return acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)
        self._upload = _Upload(sender_of(message), message.count)
        return (self._ask(now_s, self._upload),)

    def _ask(self, now_s: float, upload: _Upload) -> Message:
        upload.asked_s = now_s
        return self._rules.request(*upload.sender, len(upload.items), _FENCE)

    def _take(self, now_s: float, message: Message, *, about_fence: bool) -> tuple[Message, ...]:
        upload = self._upload
        if upload is None or not about_fence:
            return acknowledged(message, self._rules.unasked)
        if sender_of(message) != upload.sender or message.seq != len(upload.items):
            result = self._rules.out_of_turn
            return () if result is None else acknowledged(message, result)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        latitude_e7, longitude_e7 = message.x * scale, message.y * scale
        if not (abs(latitude_e7) <= 900_000_000 and abs(longitude_e7) <= 1_800_000_000):
            upload.leaves_earth, latitude_e7, longitude_e7 = True, 0, 0
        latitude_e7, longitude_e7 = round(latitude_e7), round(longitude_e7)
        place = self._frame.position(GeoPosition(latitude_e7 / 1e7, longitude_e7 / 1e7))
        upload.items.append(FenceItem(message.command, message.param1, place, latitude_e7, longitude_e7))
        if len(upload.items) < upload.count:
            return (self._ask(now_s, upload),)
        self._upload = None
        try:
            if upload.leaves_earth:
                raise ValueError("Invalid vertex location")
            self._fence.set(tuple(upload.items))
        except ValueError as error:
            return acknowledged(message, self._rules.refuse(str(error)))
        return acknowledged(message, mavlink.MAV_MISSION_ACCEPTED)


def acknowledged(message: Message, result: int) -> tuple[Message, ...]:
    """MISSION_ACK with that result, to the sender of the message."""
    return _to_sender(message, mavlink.MAVLink_mission_ack_message, result, message.mission_type)


def _item(item: FenceItem, request: Message) -> Message:
    """MISSION_ITEM_INT, or MISSION_ITEM for a MISSION_REQUEST."""
    number, sender, frame = request.seq, sender_of(request), mavlink.MAV_FRAME_GLOBAL
    if request.mission_type == _RALLY:
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
    build = mavlink.MAVLink_mission_item_int_message
    place: tuple[float, float] = item.latitude_e7, item.longitude_e7
    if request.get_type() == "MISSION_REQUEST":
        build = mavlink.MAVLink_mission_item_message
        place = item.latitude_e7 / 1e7, item.longitude_e7 / 1e7
    height_m, kind = item.place.altitude_m, request.mission_type
    return build(*sender, number, frame, item.command, 0, 0, item.number, 0, 0, 0, *place, height_m, kind)


def _rally_item(frame: LocalFrame, place: GeoPosition) -> FenceItem:
    latitude_e7, longitude_e7 = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
    point = mavlink.MAV_CMD_NAV_RALLY_POINT
    return FenceItem(point, 0.0, frame.position(place), latitude_e7, longitude_e7)


def _to_sender(message: Message, kind: Any, *fields: float) -> tuple[Message, ...]:
    return (kind(*sender_of(message), *fields),)
