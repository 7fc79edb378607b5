"""The vehicle's own fence: its parameters and its list of areas, as places of the mission.

A list with an impossible item is refused as a whole, as a partly known fence protects nothing.
Sources: ArduPilot's AC_Fence.cpp and AC_PolyFence_loader.cpp, ModeRTL::compute_return_target; PX4's geofence.cpp and
failsafe.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Circle, GeoPosition, LocalFrame, Position
from upwash.core.vehicle.geofence import AreaUnion, Fence, Polygon
from upwash.errors import AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.packets import Message
from upwash.ports import FenceNames, VehicleLimits
from upwash.real.mavlink.gate import LATITUDE_E7, LONGITUDE_E7, Range
from upwash.real.mavlink.mission_list import MOST_ITEMS, MissionList
from upwash.real.mavlink.telemetry import place_of_e7
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.support.text import counted

ARDUCOPTER_FENCE = (
    "FENCE_ENABLE", "FENCE_AUTOENABLE", "FENCE_TYPE", "FENCE_OPTIONS",
    "FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN",
)  # fmt: skip
PX4_FENCE = ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_PREDICT", "COM_OBL_RC_ACT")
_CEILING, _CIRCLE, _AREAS, _FLOOR = 1, 2, 4, 8  # of FENCE_TYPE
_NEEDED = {_CEILING: "FENCE_ALT_MAX", _CIRCLE: "FENCE_RADIUS", _FLOOR: "FENCE_ALT_MIN"}
_JOINS = 2  # of FENCE_OPTIONS
_HOLDS, _TERMINATES = 2, 4  # of GF_ACTION
_DRIFTS_M = 1.0  # of a PX4 in height, as recorded ones did
_HOVERS = 5.0  # of COM_OBL_RC_ACT

_LIST = MissionList(mavlink.MAV_MISSION_TYPE_FENCE, "fence")
_RADIUS_M, _CORNERS_EACH = Range(0.0, 1e6), Range(3, MOST_ITEMS)
_INCLUSIONS = (mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)
_CORNERS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
_CIRCLES = (mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)


async def arducopter_limits(
    vehicle: MavlinkVehicle, frame: LocalFrame, limits: VehicleLimits, parameters: Mapping[str, float]
) -> VehicleLimits:
    """The limits of an ArduCopter, whose returns stay below its ceiling by its margin.

    FENCE_AUTOENABLE switches the fence on at arming (3) or at the end of the take-off (1, 2), with FENCE_ENABLE
    0 too. Targets up to the border are accepted; the margin keeps none out.
    """
    if not (parameters.get("FENCE_ENABLE") or parameters.get("FENCE_AUTOENABLE")):
        return replace(limits, untold=_untold(parameters, "FENCE_ENABLE"))
    kinds, margin_m = int(parameters.get("FENCE_TYPE", 0)), parameters.get("FENCE_MARGIN", 0.0)
    needed = [name for kind, name in _NEEDED.items() if kinds & kind]
    highest_m = parameters.get("FENCE_ALT_MAX") if kinds & _CEILING else None
    returns_at_m = limits.returns_at_m
    fences: list[Fence] = []
    if kinds & _CIRCLE:
        fences += _circle_around(limits.home, parameters.get("FENCE_RADIUS", 0.0))
    if kinds & _AREAS:
        areas = await _download_areas(vehicle, frame)
        fences += _joined(areas) if int(parameters.get("FENCE_OPTIONS", 0)) & _JOINS else areas
    return replace(
        limits,
        fences=fences,
        highest_m=highest_m,
        lowest_m=parameters.get("FENCE_ALT_MIN") if kinds & _FLOOR else None,
        margin_m=margin_m,
        returns_at_m=returns_at_m if highest_m is None else min(returns_at_m, highest_m - margin_m),
        names=FenceNames("FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN", "RTL_ALT"),
        untold=_untold(parameters, "FENCE_TYPE", *needed) + _homeless(limits, kinds & _CIRCLE),
    )


async def px4_limits(
    vehicle: MavlinkVehicle, frame: LocalFrame, limits: VehicleLimits, parameters: Mapping[str, float]
) -> VehicleLimits:
    """The limits of a PX4, which must be in every area to stay in; AutopilotRefused if it would fall at a border."""
    action, farthest_m = parameters.get("GF_ACTION"), parameters.get("GF_MAX_HOR_DIST", 0.0)
    if not action:
        return replace(limits, untold=_untold(parameters, "GF_ACTION"))
    fences = [*_circle_around(limits.home, farthest_m), *await _download_areas(vehicle, frame)]
    highest_m = parameters.get("GF_MAX_VER_DIST") or None
    if fences or highest_m is not None:
        _check_action(vehicle, action, parameters)
    return replace(
        limits,
        fences=fences,
        highest_m=highest_m,
        margin_m=_DRIFTS_M,
        names=FenceNames(highest="GF_MAX_VER_DIST", margin="the drift of a PX4", returns_at="RTL_RETURN_ALT"),
        untold=_untold(parameters, "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST") + _homeless(limits, farthest_m),
    )


def _check_action(vehicle: MavlinkVehicle, action: float, parameters: Mapping[str, float]) -> None:
    """Warn of surprising actions at the border; AutopilotRefused if the vehicle would fall there."""
    if action == _TERMINATES:
        raise AutopilotRefused(
            "arm",
            f"GF_ACTION is {action:g} (terminate): the vehicle stops its motors and falls when it leaves its fence; "
            "set it to 3 (return) or 5 (land), or remove the fence; nothing was sent",
        )
    if action == _HOLDS and parameters.get("COM_OBL_RC_ACT") != _HOVERS:
        advice = (
            "at its fence the vehicle holds for COM_OF_LOSS_T, as the program stops sending, and then does what "
            "COM_OBL_RC_ACT says; with a GF_ACTION of 3 it returns"
        )
        vehicle.news.tell(VehicleSetting(name="GF_ACTION", value=action, advice=advice))
    if predicts := parameters.get("GF_PREDICT"):
        advice = (
            "it acts before the border is reached, which PX4 calls experimental and a cause of fly-aways; "
            "set it to 0"
        )
        vehicle.news.tell(VehicleSetting(name="GF_PREDICT", value=predicts, advice=advice))


def _untold(parameters: Mapping[str, float], *names: str) -> tuple[str, ...]:
    return tuple(name for name in names if name not in parameters)


def _homeless(limits: VehicleLimits, radius: float) -> tuple[str, ...]:
    return ("its home",) if radius and limits.home is None else ()


def _circle_around(home: Position | None, radius_m: float) -> list[Fence]:
    """The fence of a greatest distance from home; empty while home is unknown."""
    if home is None or radius_m <= 0:
        return []
    return [Fence(f"the vehicle's fence of {radius_m:g} m around its home", Circle(home, radius_m), True)]


# --- the list of areas --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Item:
    command: int
    size: float  # a circle's radius in metres, a polygon's number of corners
    place: GeoPosition


async def _download_areas(vehicle: MavlinkVehicle, frame: LocalFrame) -> list[Fence]:
    """The areas of the vehicle's fence list; AutopilotError if the list is incomplete or has impossible items."""
    items = [_item(number, message) for number, message in enumerate(await _LIST.read(vehicle))]
    return _areas(items, frame)


def _item(number: int, message: Message) -> _Item:
    size = _CORNERS_EACH if message.command in _CORNERS else _RADIUS_M
    numbers = (
        ("latitude", message.x, LATITUDE_E7),
        ("longitude", message.y, LONGITUDE_E7),
        ("size", message.param1, size),
    )
    for what, value, span in numbers if message.command in (*_CORNERS, *_CIRCLES) else ():
        if not span.least <= value <= span.most:
            raise _LIST.nonsense(f"item {number} has a {what} of {value:g}")
    return _Item(message.command, message.param1, place_of_e7(message.x, message.y))


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
                raise _LIST.nonsense(f"the corners of {name} belong to different areas")
            if len(corners) >= item.size:
                polygon = Polygon(tuple(frame.position(corner.place) for corner in corners))
                fences.append(Fence(name, polygon, inclusion))
                corners = []
    if corners:
        raise _LIST.nonsense(
            f"its last area has {len(corners)} of {counted(round(corners[0].size), 'corner')}"
        )
    return fences


def _joined(fences: Sequence[Fence]) -> list[Fence]:
    """The fences, with all areas to stay in joined into one fence, so that being in one of them is enough."""
    inclusions = [fence for fence in fences if fence.inclusion]
    if len(inclusions) < 2:
        return list(fences)
    areas = tuple(fence.area for fence in inclusions if not isinstance(fence.area, AreaUnion))
    name = f"all {len(areas)} areas to stay in of the vehicle's fence"
    return [Fence(name, AreaUnion(areas), True), *(fence for fence in fences if not fence.inclusion)]
