"""QGroundControl's `.plan`: a JSON file with a mission, a geofence and rally points."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Annotated, Any, TypeVar

import msgspec

from upwash.plans.course import make_plan
from upwash.plans.foreign import WANTED, kind_of_document
from upwash.plans.items import FASTEST_M_S, MOST_ITEMS, Item, PlanRefusal, checked_place, home_at
from upwash.plans.plan import FlightPlan, PlannedCircle, PlannedPolygon, PlanNotices
from upwash.support.text import counted, printable

T = TypeVar("T")

_LONGEST_NAME = 40  # of what a file names, as a person reads it
_MOST_CORNERS = 500  # of all fences together; an autopilot takes fewer
_LARGEST_RADIUS_M = 100_000.0
_MULTICOPTERS = (0, 2, 3, 4, 13, 14, 15, 29, 35)  # MAV_TYPE; 0 is any

Place = Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)]
OpenHome = Annotated[list[float | None], msgspec.Meta(min_length=3, max_length=3)]
_SINGLY = (
    "in QGroundControl upload the plan to a vehicle, or to a simulated one, download it again, and save that: the "
    "pattern becomes single waypoints"
)
_SAVED_ANEW = "open it in a current QGroundControl, and save it"


class _Circle(msgspec.Struct):
    center: Place
    radius: float


class _CircleFence(msgspec.Struct):
    circle: _Circle
    inclusion: bool
    version: int = 1


class _PolygonFence(msgspec.Struct):
    polygon: list[Place]
    inclusion: bool
    version: int = 1


class _GeoFence(msgspec.Struct, rename="camel"):
    circles: list[_CircleFence] = []
    polygons: list[_PolygonFence] = []
    polygon: list[Place] = []  # of version 1: to stay in
    breach_return: Any = None
    version: int = 2


class _RallyPoints(msgspec.Struct):
    points: list[Any] = []


class _Mission(msgspec.Struct, rename="camel"):
    items: list[dict[str, Any]]
    planned_home_position: OpenHome | None
    hover_speed: float | None = None
    vehicle_type: int = 2
    version: int = 2


class _Document(msgspec.Struct, rename="camel"):
    mission: _Mission
    geo_fence: _GeoFence = msgspec.field(default_factory=_GeoFence)
    rally_points: _RallyPoints = msgspec.field(default_factory=_RallyPoints)
    file_type: str = "Plan"
    version: int = 1


class _Transect(msgspec.Struct):
    items: list[dict[str, Any]] = msgspec.field(default_factory=list, name="Items")


class _Pattern(msgspec.Struct, rename="camel"):
    """A survey, a corridor scan, a structure scan: the first two keep their single commands in the file."""

    complex_item_type: str
    transect: _Transect | None = msgspec.field(default=None, name="TransectStyleComplexItem")


class _SimpleItem(msgspec.Struct, rename="camel"):
    command: int
    frame: int
    params: Annotated[list[float | None], msgspec.Meta(min_length=7, max_length=7)]
    auto_continue: bool


def parse_plan(text: str) -> FlightPlan:
    """The plan in the text of a `.plan` file; raises PlanRefusal."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PlanRefusal("", f"not valid JSON: {error}") from None
    if kind := kind_of_document(found):
        raise PlanRefusal("", f"no plan, it is {kind}; {WANTED}")
    document = _converted("", found, _Document)
    _check_kind(document)
    mission = document.mission
    if len(mission.items) > MOST_ITEMS:
        raise PlanRefusal("mission.items", f"{len(mission.items)} items: at most {MOST_ITEMS} can be flown")
    notices = PlanNotices()
    items = list(_items(mission.items, notices))
    if not items and (document.geo_fence.polygons or document.geo_fence.circles):
        raise PlanRefusal(
            "",
            "has a geofence and no waypoint in it: add waypoints in QGroundControl, or name the mission's plan",
        )
    home = home_at("plannedHomePosition", *(mission.planned_home_position or (None, None)))
    speed_m_s = mission.hover_speed
    if speed_m_s is not None and not 0 < speed_m_s <= FASTEST_M_S:
        raise PlanRefusal(
            "hoverSpeed", f"expected above 0 and up to {FASTEST_M_S:g} m/s, found {speed_m_s:g}"
        )
    fences = tuple(_fences(document.geo_fence))
    return make_plan(home, items, notices, fences=fences, ground_speed_m_s=speed_m_s)


def _check_kind(document: _Document) -> None:
    mission, fence = document.mission, document.geo_fence
    if document.file_type != "Plan":
        raise PlanRefusal("fileType", f'expected "Plan", found "{_name_of(document.file_type)}": {WANTED}')
    for where, version, known in (("version", document.version, 1), ("mission.version", mission.version, 2)):
        if version != known:
            raise PlanRefusal(where, f"expected {known}, found {version}: {_SAVED_ANEW}")
    if fence.version != 2 and (fence.version != 1 or fence.polygons or fence.circles):
        raise PlanRefusal("geoFence.version", f"expected 2, found {fence.version}: {_SAVED_ANEW}")
    if mission.vehicle_type not in _MULTICOPTERS:
        raise PlanRefusal(
            "mission.vehicleType",
            f"{mission.vehicle_type} is no multicopter: plan the flight for one (vehicle type 2)",
        )
    if document.rally_points.points:
        raise PlanRefusal("rallyPoints", "a vehicle would return there instead of home: remove them")
    if fence.breach_return is not None:
        raise PlanRefusal("geoFence.breachReturn", "is not understood: remove the breach return point")


def _items(tables: list[dict[str, Any]], notices: PlanNotices) -> Iterator[Item]:
    """The plan's single commands, those of patterns among them, numbered as QGroundControl numbers them."""
    number = 0
    for table in tables:
        inner, pattern = _singly(number + 1, table)
        if pattern:
            last = number + len(inner)
            notices.add(
                f"{pattern} is flown as its {counted(len(inner), 'single command')}, items {number + 1}-{last}"
            )
        for item in inner:
            number += 1
            if number > MOST_ITEMS:
                raise PlanRefusal(
                    "mission.items", f"more than {MOST_ITEMS} items, those of patterns counted: fly less"
                )
            yield _item(number, item)


def _singly(number: int, table: dict[str, Any]) -> tuple[list[dict[str, Any]], str]:
    """The single commands of an item of the file, and the pattern's name where the item is one."""
    kind, where = table.get("type"), f"item {number}"
    if kind == "SimpleItem":
        return [table], ""
    if kind != "ComplexItem":
        raise PlanRefusal(
            where, f"{_name_of(kind or 'an item without a type')} is not understood: {_SAVED_ANEW}"
        )
    pattern = _converted(where, table, _Pattern)
    inner = pattern.transect.items if pattern.transect else []
    name = _name_of(pattern.complex_item_type)
    if not inner:
        raise PlanRefusal(where, f"ComplexItem ({name}) has no single waypoints in the file: {_SINGLY}")
    return inner, name


def _item(number: int, table: dict[str, Any]) -> Item:
    where = f"item {number}"
    if table.get("type") != "SimpleItem":
        raise PlanRefusal(where, f'has type "{_name_of(table.get("type"))}" within a pattern: {_SINGLY}')
    item = _converted(where, table, _SimpleItem)
    return Item(number, item.command, item.frame, tuple(item.params), item.auto_continue)


def _fences(fence: _GeoFence) -> Iterator[PlannedPolygon | PlannedCircle]:
    polygons = list(fence.polygons)
    if fence.polygon:
        polygons.append(_PolygonFence(polygon=fence.polygon, inclusion=True))
    if sum(len(polygon.polygon) for polygon in polygons) + len(fence.circles) > _MOST_CORNERS:
        raise PlanRefusal("geoFence", f"more than {_MOST_CORNERS} corners: draw it with fewer")
    for number, polygon in enumerate(polygons, start=1):
        name = _name(polygon, "polygon", number)
        if len(polygon.polygon) < 3:
            raise PlanRefusal(name, f"{counted(len(polygon.polygon), 'corner')}: a polygon has at least 3")
        corners = tuple(checked_place(name, *corner) for corner in polygon.polygon)
        yield PlannedPolygon(name, polygon.inclusion, corners)
    for number, circle in enumerate(fence.circles, start=1):
        name, radius_m = _name(circle, "circle", number), circle.circle.radius
        if not 0 < radius_m <= _LARGEST_RADIUS_M:
            raise PlanRefusal(name, f"radius {radius_m:g} m: expected above 0, up to 100 km")
        centre = checked_place(name, *circle.circle.center)
        yield PlannedCircle(name, circle.inclusion, centre, radius_m)


def _name(fence: _PolygonFence | _CircleFence, shape: str, number: int) -> str:
    name = f"{'inclusion' if fence.inclusion else 'exclusion'} {shape} {number}"
    if fence.version != 1:
        raise PlanRefusal(name, f"version {fence.version} is not understood: {_SAVED_ANEW}")
    return name


def _converted(where: str, value: object, kind: type[T]) -> T:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise PlanRefusal(where, f"{error}: {_SAVED_ANEW}") from None


def _name_of(found: object) -> str:
    """A word of the file as a message quotes it."""
    return printable(str(found), _LONGEST_NAME)
