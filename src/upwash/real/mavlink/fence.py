"""The list of areas that a vehicle's fence has: downloaded, and as places of the mission.

A list that makes no sense is refused as a whole: a fence that is only partly known keeps the vehicle out of nothing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, GeoPosition, LocalFrame, Position
from upwash.core.vehicle.geofence import AreaUnion, Fence, Polygon
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.ranges import LATITUDE_E7, LONGITUDE_E7, Range
from upwash.real.mavlink.vehicle import MavlinkVehicle

_TYPE = mavlink.MAV_MISSION_TYPE_FENCE
_ATTEMPTS = 5
_MOST_ITEMS = 1_000
_LONGEST_S = 600.0
_RADIUS_M, _CORNERS_EACH = Range(0.0, 1e6), Range(3, _MOST_ITEMS)
_INCLUSIONS = (mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)
_CORNERS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
_CIRCLES = (mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)


@dataclass(frozen=True, slots=True)
class _Item:
    command: int
    size: float  # a circle's radius in metres, a polygon's number of corners
    place: GeoPosition


async def download_fence(vehicle: MavlinkVehicle, frame: LocalFrame, *, joins: bool = False) -> list[Fence]:
    """The areas of the vehicle's fence list; AutopilotError where it does not give all of it, or it makes no sense.

    A vehicle that `joins` the areas to stay in has one fence of them: one area is enough.
    """
    async with vehicle.limited("fence", _LONGEST_S):
        fences = _areas(await _items(vehicle), frame)
    return _joined(fences) if joins else fences


def circle_around(home: Position | None, radius_m: float) -> list[Fence]:
    """The fence of a greatest distance from home, none while that is not known."""
    if home is None or radius_m <= 0:
        return []
    return [Fence(f"the vehicle's fence of {radius_m:g} m around its home", Circle(home, radius_m), True)]


async def _items(vehicle: MavlinkVehicle) -> list[_Item]:
    answers: asyncio.Queue[Message] = asyncio.Queue()

    def hear(message: Message) -> None:
        wanted = message.get_type() in ("MISSION_COUNT", "MISSION_ITEM_INT")
        if wanted and message.mission_type == _TYPE:
            answers.put_nowait(message)

    with vehicle.listening(hear):
        count = (await _asked(vehicle, answers, "MISSION_COUNT", None)).count
        if count > _MOST_ITEMS:
            raise AutopilotTimeout("fence", f"the vehicle's fence has {count} items, more than {_MOST_ITEMS}")
        items = [
            _item(number, await _asked(vehicle, answers, "MISSION_ITEM_INT", number))
            for number in range(count)
        ]
    vehicle.ask(_thanks)  # PX4 reports a failed transfer without it
    return items


def _thanks(system: int, component: int) -> Message:
    return mavlink.MAVLink_mission_ack_message(system, component, mavlink.MAV_MISSION_ACCEPTED, _TYPE)


async def _asked(
    vehicle: MavlinkVehicle, answers: asyncio.Queue[Message], kind: str, number: int | None
) -> Message:
    def question(system: int, component: int) -> Message:
        if number is None:
            return mavlink.MAVLink_mission_request_list_message(system, component, _TYPE)
        return mavlink.MAVLink_mission_request_int_message(system, component, number, _TYPE)

    for _ in range(_ATTEMPTS):
        vehicle.ask(question)
        try:
            async with asyncio.timeout(vehicle.patience.answer_s):
                while True:
                    message = await answers.get()
                    if message.get_type() == kind and number in (None, getattr(message, "seq", None)):
                        return message
        except TimeoutError:
            continue
    what = "how many items it has" if number is None else f"item {number}"
    raise AutopilotTimeout("fence", f"the vehicle did not tell {what} of its fence", vehicle.said_lately)


def _item(number: int, message: Message) -> _Item:
    size = _CORNERS_EACH if message.command in _CORNERS else _RADIUS_M
    numbers = (
        ("latitude", message.x, LATITUDE_E7),
        ("longitude", message.y, LONGITUDE_E7),
        ("size", message.param1, size),
    )
    for what, value, span in numbers if message.command in (*_CORNERS, *_CIRCLES) else ():
        if not span.least <= value <= span.most:
            raise _nonsense(f"item {number} has a {what} of {value:g}")
    return _Item(message.command, message.param1, GeoPosition(message.x / 1e7, message.y / 1e7))


def _nonsense(what: str) -> AutopilotRefused:
    return AutopilotRefused(
        "fence", f"the vehicle's fence makes no sense: {what}; upload the fence anew; nothing was sent"
    )


def _areas(items: Sequence[_Item], frame: LocalFrame) -> list[Fence]:
    fences: list[Fence] = []
    corners: list[_Item] = []
    for item in items:
        name, inclusion = f"area {len(fences) + 1} of the vehicle's fence", item.command in _INCLUSIONS
        if item.command in _CIRCLES:
            fences.append(Fence(name, Circle(frame.position(item.place), item.size), inclusion))
        elif item.command in _CORNERS:
            corners.append(item)
            if (item.command, item.size) != (corners[0].command, corners[0].size):
                raise _nonsense(f"the corners of {name} belong to different areas")
            if len(corners) >= item.size:
                fences.append(
                    Fence(name, Polygon(tuple(frame.position(each.place) for each in corners)), inclusion)
                )
                corners = []
    if corners:
        raise _nonsense(f"its last area has {len(corners)} of {corners[0].size:g} corners")
    return fences


def _joined(fences: Sequence[Fence]) -> list[Fence]:
    """The areas to stay in as one fence, in the place of the first of them."""
    inclusions = [fence for fence in fences if fence.inclusion]
    if len(inclusions) < 2:
        return list(fences)
    areas = tuple(fence.area for fence in inclusions if not isinstance(fence.area, AreaUnion))
    name = f"all {len(areas)} areas to stay in of the vehicle's fence"
    return [Fence(name, AreaUnion(areas), True), *(fence for fence in fences if not fence.inclusion)]
