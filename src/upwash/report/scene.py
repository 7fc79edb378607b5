"""A run as a scene in three dimensions: plan, ranges by the servers' states, the drone, and where calls ran."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from upwash.core.geo import Circle, Position
from upwash.core.servers import State
from upwash.report.foxglove import (
    LINE_LOOP,
    LINE_STRIP,
    Color,
    CylinderPrimitive,
    LinePrimitive,
    Pose,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Time,
    Vector3,
    vector,
)
from upwash.report.places import COLOURS, name_of
from upwash.report.record import Call, Record, Stretch

FRAME = "home"  # east, north and up of it
_SIDES = 64  # of the line around a range
_DRONE_M, _CALL_M, _WAYPOINT_M = 4.0, 2.5, 1.0  # sizes
_RANGE_HEIGHT_M = 0.2

_WHITE, _FAINT, _DRONE = Color(1.0, 1.0, 1.0), Color(1.0, 1.0, 1.0, 0.4), Color(0.2, 0.7, 1.0)
_STATES = {  # each label also says the state in letters
    State.AVL: Color(0.6, 0.6, 0.6, 0.15),
    State.AVL_R: Color(0.6, 0.6, 0.9, 0.2),
    State.CHECK: Color(0.95, 0.75, 0.2, 0.3),
    State.CHECK_R: Color(0.95, 0.75, 0.2, 0.3),
    State.READY: Color(0.2, 0.75, 0.45, 0.35),
    State.BLACKLISTED: Color(0.85, 0.25, 0.25, 0.3),
}
_PLACES = (
    Color(0.65, 0.69, 0.73),
    Color(0.96, 0.65, 0.26),
    Color(0.48, 0.65, 1.0),
    Color(0.31, 0.82, 0.63),
    Color(0.9, 0.55, 0.94),
    Color(1.0, 0.55, 0.55),
    Color(0.71, 0.83, 0.33),
)


def scene(record: Record, time_of: Callable[[float], Time]) -> Iterator[tuple[float, SceneUpdate]]:
    """What is new in the scene at which second of the mission; `time_of` tells the time of day of a second."""

    def update(at_s: float, *entities: SceneEntity) -> tuple[float, SceneUpdate]:
        return at_s, SceneUpdate(list(entities))

    yield update(0.0, _plan(record, time_of(0.0)))
    for server, stretches in record.stretches.items():
        if (area := record.plan.ranges.get(server)) is not None:
            for stretch in stretches:
                yield update(stretch.from_s, _range(server, area, stretch, time_of(stretch.from_s)))
    for fix in record.track:
        yield update(fix.at_s, _drone(fix.position, time_of(fix.at_s)))
    for index, call in enumerate(record.calls):
        if call.position is not None:
            ended_s = call.result.at_s + call.result.delay_s
            yield update(ended_s, _call(index, call, call.position, record, time_of(ended_s)))


def _plan(record: Record, time: Time) -> SceneEntity:
    altitude_m = max(
        (fix.position.altitude_m for fix in record.track), default=0.0
    )  # the plan's own is not logged
    places = [Position(east_m, north_m, altitude_m) for east_m, north_m in record.plan.waypoints_m]
    return SceneEntity(
        time,
        FRAME,
        "plan",
        lines=[LinePrimitive(LINE_STRIP, [vector(place) for place in places], _FAINT)],
        spheres=[SpherePrimitive(Pose(vector(place)), _cube(_WAYPOINT_M), _FAINT) for place in places],
        texts=[_label("home", Vector3())],
    )


def _range(server: str, area: Circle, stretch: Stretch, time: Time) -> SceneEntity:
    colour = _STATES[stretch.state]
    border = [vector(corner) for corner in area.corners(_SIDES)]
    return SceneEntity(
        time,
        FRAME,
        f"server {server}",
        cylinders=[
            CylinderPrimitive(
                Pose(vector(area.centre)),
                Vector3(2 * area.radius_m, 2 * area.radius_m, _RANGE_HEIGHT_M),
                colour,
            )
        ],
        lines=[LinePrimitive(LINE_LOOP, border, Color(colour.r, colour.g, colour.b))],
        texts=[_label(f"{server} {stretch.state}", vector(area.centre, above_m=2.0))],
    )


def _drone(place: Position, time: Time) -> SceneEntity:
    ground = Vector3(place.east_m, place.north_m)
    return SceneEntity(
        time,
        FRAME,
        "drone",
        spheres=[SpherePrimitive(Pose(vector(place)), _cube(_DRONE_M), _DRONE)],
        lines=[LinePrimitive(LINE_STRIP, [ground, vector(place)], _DRONE)],
        texts=[_label("drone", vector(place, above_m=_DRONE_M))],
    )


def _call(index: int, call: Call, place: Position, record: Record, time: Time) -> SceneEntity:
    return SceneEntity(
        time,
        FRAME,
        f"call {index}: {name_of(call.result.place)}",
        spheres=[SpherePrimitive(Pose(vector(place)), _cube(_CALL_M), _colour(call.result.place, record))],
    )


def _colour(place: str, record: Record) -> Color:
    return _PLACES[0] if place == "local" else _PLACES[1 + record.servers.index(place) % COLOURS]


def _cube(side_m: float) -> Vector3:
    return Vector3(side_m, side_m, side_m)


def _label(text: str, place: Vector3) -> TextPrimitive:
    return TextPrimitive(Pose(place), text, _WHITE)
