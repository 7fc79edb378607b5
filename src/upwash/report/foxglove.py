"""The messages of an MCAP file as Foxglove and its kin know them, and the JSON schemas that describe them.

Fields and numbers are those of https://docs.foxglove.dev/docs/sdk/schemas; what this project never sends is left out.
A place is in metres east, north and up.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta, Struct

from upwash.core.geo import Position

LINE_STRIP, LINE_LOOP = 0, 1
INFO, WARNING, ERROR = 2, 3, 4

_Level = Annotated[int, Meta(ge=0, le=5)]
_Nanoseconds = Annotated[int, Meta(ge=0, lt=1_000_000_000)]
_Share = Annotated[float, Meta(ge=0, le=1)]
_Matrix = Annotated[list[float], Meta(min_length=9, max_length=9)]


class Time(Struct, frozen=True):
    """A time of day since 1970."""

    sec: Annotated[int, Meta(ge=0)]
    nsec: _Nanoseconds


class Duration(Struct, frozen=True):
    """A length of time; none means for ever."""

    sec: int = 0
    nsec: _Nanoseconds = 0


class Vector3(Struct, frozen=True):
    """A place or a size."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Quaternion(Struct, frozen=True):
    """A turn; this one is none."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(Struct, frozen=True):
    """A place and a turn."""

    position: Vector3
    orientation: Quaternion = Quaternion()


class Color(Struct, frozen=True):
    """Red, green, blue and opacity."""

    r: _Share
    g: _Share
    b: _Share
    a: _Share = 1.0


class SpherePrimitive(Struct, frozen=True):
    """A ball."""

    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(Struct, frozen=True):
    """An upright cylinder around its middle."""

    pose: Pose
    size: Vector3
    color: Color
    bottom_scale: _Share = 1.0
    top_scale: _Share = 1.0


class LinePrimitive(Struct, frozen=True):
    """A line through points; its thickness is in pixels where it is scale-invariant."""

    type: _Level
    points: list[Vector3]
    color: Color
    pose: Pose = Pose(Vector3())
    thickness: float = 2.0
    scale_invariant: bool = True
    colors: list[Color] = []
    indices: list[int] = []


class TextPrimitive(Struct, frozen=True):
    """A label that faces whoever looks."""

    pose: Pose
    text: str
    color: Color
    billboard: bool = True
    font_size: float = 14.0
    scale_invariant: bool = True


class Unsent(Struct, frozen=True):
    """Something of which there is never any: readers expect its list."""


class SceneEntity(Struct, frozen=True):
    """One thing in the scene, in the place of the former one of that `id`."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Duration = Duration()
    frame_locked: bool = False
    metadata: list[Unsent] = []
    arrows: list[Unsent] = []
    cubes: list[Unsent] = []
    spheres: list[SpherePrimitive] = []
    cylinders: list[CylinderPrimitive] = []
    lines: list[LinePrimitive] = []
    triangles: list[Unsent] = []
    texts: list[TextPrimitive] = []
    models: list[Unsent] = []


class SceneUpdate(Struct, frozen=True):
    """What is new in the scene."""

    schema: ClassVar[str] = "foxglove.SceneUpdate"
    entities: list[SceneEntity]
    deletions: list[Unsent] = []


class LocationFix(Struct, frozen=True):
    """Where the drone is on the Earth; the altitude is above home."""

    schema: ClassVar[str] = "foxglove.LocationFix"
    timestamp: Time
    frame_id: str
    latitude: float
    longitude: float
    altitude: float
    position_covariance: _Matrix
    position_covariance_type: Annotated[int, Meta(ge=0, le=3)] = 0  # unknown


class Log(Struct, frozen=True):
    """A line for a person."""

    schema: ClassVar[str] = "foxglove.Log"
    timestamp: Time
    level: _Level
    message: str
    name: str
    file: str = ""
    line: int = 0


class CompressedImage(Struct, frozen=True):
    """A photo."""

    schema: ClassVar[str] = "foxglove.CompressedImage"
    timestamp: Time
    frame_id: str
    data: bytes
    format: str = "jpeg"


Message = SceneUpdate | LocationFix | Log | CompressedImage


def vector(place: Position, *, above_m: float = 0.0) -> Vector3:
    """A place in the scene."""
    return Vector3(place.east_m, place.north_m, place.altitude_m + above_m)


def json_schema(message: type[Message]) -> dict[str, Any]:
    """The schema of a message in one piece: readers of MCAP files follow no references."""
    (_,), definitions = msgspec.json.schema_components([message], ref_template="{name}")
    return _inlined(definitions[message.__name__], definitions)  # type: ignore[no-any-return]


def _inlined(part: Any, definitions: dict[str, Any]) -> Any:
    match part:
        case {"$ref": str(name)}:
            return _inlined(definitions[name], definitions)
        case {"type": "object", "title": ("Time" | "Duration") as name, **rest}:
            return {**_inlined(rest, definitions), "type": "object", "title": name.lower()}
        case {"type": "object", "title": str(name), **rest}:
            return {**_inlined(rest, definitions), "type": "object", "title": f"foxglove.{name}"}
        case dict():
            return {key: _inlined(value, definitions) for key, value in part.items() if key != "default"}
        case list():
            return [_inlined(value, definitions) for value in part]
        case _:
            return part
