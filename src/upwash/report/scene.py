"""A run as a scene in three dimensions: plan, ranges by the servers' states, the drone, and where calls ran."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from foxglove.messages import (
    Color,
    CylinderPrimitive,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.servers import State
from upwash.eventlog.narration import STATE_WORDS
from upwash.report.exports import SIDES
from upwash.report.palette import DARK, components
from upwash.report.record import Record
from upwash.report.story import Stretch

FRAME = "home"  # east, north and up of it
_DRONE_M, _CALL_M, _WAYPOINT_M = 4.0, 2.5, 1.0  # sizes
_RANGE_HEIGHT_M = 0.2


def _shade(red: float, green: float, blue: float, opacity: float = 1.0) -> Color:
    return Color(r=red, g=green, b=blue, a=opacity)


_WHITE, _FAINT, _DRONE = _shade(1.0, 1.0, 1.0), _shade(1.0, 1.0, 1.0, 0.4), _shade(0.2, 0.7, 1.0)
_STATES = {  # each label also says the state in words
    State.AVL: (0.6, 0.6, 0.6, 0.15),
    State.AVL_R: (0.6, 0.6, 0.9, 0.2),
    State.CHECK: (0.95, 0.75, 0.2, 0.3),
    State.CHECK_R: (0.95, 0.75, 0.2, 0.3),
    State.READY: (0.2, 0.75, 0.45, 0.35),
    State.BLACKLISTED: (0.85, 0.25, 0.25, 0.3),
}


def scene(record: Record, time_of: Callable[[float], Timestamp]) -> Iterator[tuple[float, SceneUpdate]]:
    """What is new in the scene at which second of the mission; `time_of` tells the time of day of a second."""

    def update(at_s: float, *entities: SceneEntity) -> tuple[float, SceneUpdate]:
        return at_s, SceneUpdate(entities=list(entities))

    yield update(0.0, _plan(record, time_of(0.0)))
    for server, stretches in record.stretches.items():
        if (area := record.plan.ranges.get(server)) is not None:
            for stretch in stretches:
                yield update(stretch.from_s, _range(server, area, stretch, time_of(stretch.from_s)))
    for fix in record.track:
        yield update(fix.at_s, _drone(fix.position, time_of(fix.at_s)))
    for index, (call, place) in enumerate(zip(record.calls, record.places, strict=True)):
        if place is not None:
            ended_s = call.at_s + call.delay_s
            yield update(ended_s, _call(index, call.server, place, record, time_of(ended_s)))


def _entity(name: str, time: Timestamp, **parts: Any) -> SceneEntity:
    return SceneEntity(timestamp=time, frame_id=FRAME, id=name, **parts)


def _plan(record: Record, time: Timestamp) -> SceneEntity:
    way_m = record.plan.way_m
    altitudes_m = record.plan.way_altitudes_m
    if not altitudes_m:  # the log does not say how high the plan was
        altitudes_m = [max((fix.position.altitude_m for fix in record.track), default=0.0)] * len(way_m)
    places = [Position(*place, altitude_m) for place, altitude_m in zip(way_m, altitudes_m, strict=True)]
    balls = [_ball(place, _WAYPOINT_M, _FAINT) for place in places]
    label = _label("home", Position(0.0, 0.0))
    return _entity("plan", time, lines=[_line(places, _FAINT)], spheres=balls, texts=[label])


def _range(server: str, area: Circle, stretch: Stretch, time: Timestamp) -> SceneEntity:
    red, green, blue, opacity = _STATES[stretch.state]
    cylinder = CylinderPrimitive(
        pose=_upright(area.centre),
        size=Vector3(x=2 * area.radius_m, y=2 * area.radius_m, z=_RANGE_HEIGHT_M),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_shade(red, green, blue, opacity),
    )
    border = _line(area.corners(SIDES), _shade(red, green, blue), LinePrimitiveLineType.LineLoop)
    label = _label(f"{server} {STATE_WORDS[stretch.state]}", area.centre, above_m=2.0)
    return _entity(f"server {server}", time, cylinders=[cylinder], lines=[border], texts=[label])


def _drone(place: Position, time: Timestamp) -> SceneEntity:
    line = _line([Position(place.east_m, place.north_m), place], _DRONE)
    label = _label("drone", place, above_m=_DRONE_M)
    return _entity("drone", time, spheres=[_ball(place, _DRONE_M, _DRONE)], lines=[line], texts=[label])


def _call(index: int, server: str | None, place: Position, record: Record, time: Timestamp) -> SceneEntity:
    colour = _shade(*components(DARK.of_place(server, record.servers)))
    return _entity(f"call {index}: {server or 'drone'}", time, spheres=[_ball(place, _CALL_M, colour)])


def _line(
    places: Iterable[Position],
    colour: Color,
    kind: LinePrimitiveLineType = LinePrimitiveLineType.LineStrip,
) -> LinePrimitive:
    points = [Point3(x=place.east_m, y=place.north_m, z=place.altitude_m) for place in places]
    return LinePrimitive(
        type=kind,
        pose=_upright(Position(0.0, 0.0)),
        points=points,
        color=colour,
        thickness=2.0,
        scale_invariant=True,
    )


def _ball(place: Position, width_m: float, colour: Color) -> SpherePrimitive:
    return SpherePrimitive(pose=_upright(place), size=Vector3(x=width_m, y=width_m, z=width_m), color=colour)


def _label(text: str, place: Position, *, above_m: float = 0.0) -> TextPrimitive:
    return TextPrimitive(
        pose=_upright(place, above_m),
        text=text,
        color=_WHITE,
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
    )


def _upright(place: Position, above_m: float = 0.0) -> Pose:
    position = Vector3(x=place.east_m, y=place.north_m, z=place.altitude_m + above_m)
    return Pose(position=position, orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
