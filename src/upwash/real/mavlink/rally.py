"""The vehicle's rally points and its firmware's rule for the place of a return, read before arming.

An unknown place of return is refused: the reserve would count another way home than the vehicle flies.
Sources: ArduPilot's AP_Rally.cpp, MissionItemProtocol_Rally.cpp and mode_rtl.cpp; PX4's rtl.cpp (1.16.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import LocalFrame, Position, ground_distance_m
from upwash.core.vehicle.geofence import breached_by_position
from upwash.core.vehicle.return_place import NO_RALLY_POINTS, RallyPoints, ReturnPlace
from upwash.core.vehicle.way_home import WayHome
from upwash.errors import AutopilotRefused
from upwash.mavlink.packets import Message, name_of
from upwash.ports import VehicleLimits
from upwash.real.mavlink.gate import LATITUDE_E7, LONGITUDE_E7
from upwash.real.mavlink.mission_list import MissionList
from upwash.real.mavlink.parameters import Reading, read_parameters
from upwash.real.mavlink.telemetry import place_of_e7
from upwash.real.mavlink.vehicle import MavlinkVehicle

_RALLY = MissionList(mavlink.MAV_MISSION_TYPE_RALLY, "list of rally points")
_MISSION = MissionList(mavlink.MAV_MISSION_TYPE_MISSION, "stored mission")
_ABOVE_SEA = mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT
_ABOVE_HOME = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
_LANDINGS = mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_NAV_VTOL_LAND, mavlink.MAV_CMD_DO_LAND_START
_TOTAL, _LIMIT, _HOME_COUNTS, _TYPE = "RALLY_TOTAL", "RALLY_LIMIT_KM", "RALLY_INCL_HOME", "RTL_TYPE"
_PREFERS_POINTS, _BY_MISSION, _MAY_USE_MISSION, _POINTS_ONLY = 1, (2, 4), (1, 3), 5  # of RTL_TYPE
_UNUSABLE_FRAME = 26128688  # PX4's event rtl_unsupported_mav_frame
_LOOKS_S = 3.0  # PX4 looks at its rally points each 2 s
_AT_HOME_M, _NEARER_M = 10.0, 2.0  # PX4's MAX_DIST_FROM_HOME_FOR_LAND_APPROACHES and MIN_DIST_THRESHOLD


@dataclass(frozen=True, slots=True)
class RallySite:
    """What counts the vehicle's rally points: its frame, its limits, and how it returns."""

    frame: LocalFrame
    limits: VehicleLimits
    way: WayHome


async def arducopter_rally(vehicle: MavlinkVehicle, site: RallySite) -> RallyPoints:
    """An ArduCopter's rally points; it uses none outside its fence. AutopilotError if they cannot be counted."""
    told = await read_parameters(vehicle, (_TOTAL, _LIMIT, _HOME_COUNTS))
    if _TOTAL in told.absent or told.get(_TOTAL) == 0:
        return NO_RALLY_POINTS
    items = await _RALLY.read(vehicle)
    if not items:
        return NO_RALLY_POINTS
    _require(told, _LIMIT, _HOME_COUNTS)
    limits = site.limits
    points = []
    for point in _points(items, site):
        if not _is_fenced_off(point.position, limits):
            top_m = max(site.way.altitude_m, point.position.altitude_m)
            if limits.highest_m is not None:
                top_m = min(top_m, limits.highest_m - limits.margin_m)
            points.append(_on_ground(point, altitude_m=top_m, low_m=site.way.low_m))
    limit_m = told[_LIMIT] * 1000 if told[_LIMIT] > 0 else float("inf")
    return RallyPoints(tuple(points), home_counts=bool(told[_HOME_COUNTS]), limit_m=limit_m)


async def px4_rally(vehicle: MavlinkVehicle, site: RallySite) -> RallyPoints:
    """A PX4's rally points, as far as its RTL_TYPE uses them. AutopilotError if they cannot be counted."""
    told = await read_parameters(vehicle, (_TYPE,))
    kind = int(told.get(_TYPE, 0))
    if kind in _BY_MISSION:
        if await _MISSION.count(vehicle):
            raise _refused(f"{_TYPE} is {kind}: returns follow the mission that is stored in the vehicle")
        return NO_RALLY_POINTS
    if kind in _MAY_USE_MISSION and any(item.command in _LANDINGS for item in await _MISSION.read(vehicle)):
        raise _refused(
            f"{_TYPE} is {kind}: returns may end at the landing of the mission stored in the vehicle"
        )
    points = [
        _on_ground(point, altitude_m=above_m + site.way.altitude_m, low_m=above_m + site.way.low_m)
        for point in _points(await _RALLY.read(vehicle), site)
        for above_m in (point.position.altitude_m,)
        if kind == _POINTS_ONLY or not _is_at_home(point.position, site.limits)
    ]
    if points:
        _require(told, _TYPE)
        await _require_usable_frames(vehicle)
    elif kind == _POINTS_ONLY:
        raise AutopilotRefused(
            "arm",
            f"{_TYPE} is {kind}, and the vehicle has no rally points: a return lands wherever it last heard a ground "
            f"station; upload rally points, or set {_TYPE} to 0; nothing was sent",
        )
    home_counts = kind not in (_PREFERS_POINTS, _POINTS_ONLY)
    return RallyPoints(tuple(points), home_counts=home_counts, nearer_by_m=_NEARER_M)


async def _require_usable_frames(vehicle: MavlinkVehicle) -> None:
    """Raise AutopilotRefused if a PX4 says that it cannot use the frame of a point: its returns then fly anywhere.

    PX4 stores any frame, and tells it as a usable one.
    """
    said: list[Message] = []

    def hear(message: Message) -> None:
        if message.get_type() == "EVENT" and message.id_of_event == _UNUSABLE_FRAME:
            said.append(message)

    with vehicle.listening(hear):
        if await vehicle.happens(_RALLY.name, lambda: bool(said), within_s=_LOOKS_S):
            raise AutopilotRefused(
                "arm",
                "the vehicle has rally points in a frame that its returns cannot use, such as "
                "MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, and would fly to no known place; upload them in "
                "MAV_FRAME_GLOBAL_RELATIVE_ALT, as QGroundControl does, or clear them; nothing was sent",
            )


def _refused(what: str) -> AutopilotRefused:
    return AutopilotRefused(
        "arm",
        f"{what}, which upwash cannot count; clear the stored mission, or set {_TYPE} to 0; nothing was sent",
    )


def _require(told: Reading, *names: str) -> None:
    """Raise AutopilotRefused if one of the parameters that choose the place of a return is not known."""
    for name in names:
        if name not in told:
            raise AutopilotRefused(
                "arm",
                f"the vehicle has rally points, and {told.why_unknown(name)}: where a return ends is not known; try "
                "again, or clear the rally points; nothing was sent",
            )


def _points(items: Sequence[Message], site: RallySite) -> Iterator[ReturnPlace]:
    """The rally points among the items, each at its altitude above home."""
    for number, item in enumerate(items, 1):
        if item.command != mavlink.MAV_CMD_NAV_RALLY_POINT:
            continue
        for what, value, span in (("latitude", item.x, LATITUDE_E7), ("longitude", item.y, LONGITUDE_E7)):
            if not span.least <= value <= span.most:
                raise _RALLY.nonsense(f"item {number} has a {what} of {value:g}")
        place = site.frame.position(place_of_e7(item.x, item.y))
        yield ReturnPlace(
            f"rally point {number}",
            place.at_altitude(_above_home_m(number, item, site.limits.home_above_sea_m)),
        )


def _above_home_m(number: int, item: Message, home_above_sea_m: float | None) -> float:
    if item.frame in _ABOVE_HOME:
        return float(item.z)
    if item.frame in _ABOVE_SEA and home_above_sea_m is not None:
        return float(item.z) - home_above_sea_m
    frame = name_of("MAV_FRAME", item.frame)
    raise AutopilotRefused(
        "arm",
        f"rally point {number} has its altitude of {item.z:g} m in {frame}, and upwash cannot count that above the "
        "vehicle's home; upload it with an altitude above home; nothing was sent",
    )


def _on_ground(point: ReturnPlace, *, altitude_m: float, low_m: float) -> ReturnPlace:
    """The point with the lowest ground that its altitude allows: that altitude need not be the ground."""
    ground = point.position.at_altitude(min(point.position.altitude_m, 0.0))
    return ReturnPlace(point.name, ground, altitude_m, low_m)


def _is_fenced_off(place: Position, limits: VehicleLimits) -> bool:
    highest_m, lowest_m = limits.highest_m, limits.lowest_m
    too_high = highest_m is not None and place.altitude_m >= highest_m
    too_low = lowest_m is not None and place.altitude_m <= lowest_m
    return too_high or too_low or breached_by_position(limits.fences, place) is not None


def _is_at_home(place: Position, limits: VehicleLimits) -> bool:
    return limits.home is not None and ground_distance_m(place, limits.home) <= _AT_HOME_M
