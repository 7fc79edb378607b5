"""The fence over MAVLink's mission protocol: items come one by one, and are taken all or none."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.vehicle.ardupilot.boot import WARNING, Text
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.fence import FenceItem

_MOST_ITEMS = 500


class FenceTransfer:
    """One peer's upload; what it returns is the MAV_MISSION_RESULT at its end, or None while more is to come."""

    def __init__(self, copter: Copter) -> None:
        self._copter = copter
        self._count: int | None = None
        self._items: list[FenceItem] = []
        self.complaint: tuple[Text, ...] = ()  # about the latest upload

    @property
    def next_number(self) -> int:
        """The number of the item that is to come."""
        return len(self._items)

    def begin(self, count: int) -> int | None:
        """An upload of so many items has been announced."""
        if count > _MOST_ITEMS:
            return int(mavlink.MAV_MISSION_NO_SPACE)
        self._count, self._items, self.complaint = count, [], ()
        return self._finish() if count == 0 else None

    def take(self, message: Any) -> int | None:
        """One item has come."""
        if self._count is None or message.seq != self.next_number:
            return int(mavlink.MAV_MISSION_INVALID_SEQUENCE)
        scale = 1 if message.get_type() == "MISSION_ITEM_INT" else 1e7
        latitude_e7, longitude_e7 = round(message.x * scale), round(message.y * scale)
        place = self._copter.frame.position(GeoPosition(latitude_e7 / 1e7, longitude_e7 / 1e7))
        self._items.append(FenceItem(message.command, message.param1, place, latitude_e7, longitude_e7))
        return self._finish() if len(self._items) == self._count else None

    def _finish(self) -> int:
        self._count = None
        try:
            self._copter.fence.set(tuple(self._items))
        except ValueError as error:
            self._copter.fence.set(())
            self.complaint = (Text(str(error), WARNING), Text("Fence validation failed", WARNING))
            return int(mavlink.MAV_MISSION_ERROR)
        return int(mavlink.MAV_MISSION_ACCEPTED)


def fence_message(item: FenceItem, number: int, request: Any) -> Any:
    """MISSION_ITEM_INT, or MISSION_ITEM if that was asked for."""
    in_floats = request.get_type() == "MISSION_REQUEST"
    build = mavlink.MAVLink_mission_item_message if in_floats else mavlink.MAVLink_mission_item_int_message
    place = (
        (item.latitude_e7 / 1e7, item.longitude_e7 / 1e7)
        if in_floats
        else (item.latitude_e7, item.longitude_e7)
    )
    return build(
        request.get_srcSystem(),
        request.get_srcComponent(),
        number,
        mavlink.MAV_FRAME_GLOBAL,
        item.command,
        0,
        0,
        item.number,
        0,
        0,
        0,
        *place,
        0,
        mavlink.MAV_MISSION_TYPE_FENCE,
    )
