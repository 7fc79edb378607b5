"""Plans with camera triggers, as QGroundControl saves them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from upwash.core.geo import GeoPosition, LocalFrame, Position

HOME = (39.3666, 22.9507)
FRAME = LocalFrame(GeoPosition(*HOME))
CONFIG = """
[mission]
plan = "field.plan"
action_s = 5.0
{mission}
[camera]
photo_s = {photo_s}
[[service]]
name = "detector"
local_call_s = {{ light = 0.5, heavy = {heavy_s} }}
{more}
"""
Item = dict[str, Any]
Place = tuple[float, float]


def item(command: int, *parameters: float | None, frame: int = 2) -> Item:
    """An item as QGroundControl saves it; NaN is null there."""
    filled = [*parameters, *[0] * (7 - len(parameters))]
    return {
        "autoContinue": True, "command": command, "frame": frame, "params": filled, "type": "SimpleItem",
    }  # fmt: skip


def at(east_m: float, north_m: float, altitude_m: float = 25.0, hold_s: float = 0.0) -> Item:
    geo = FRAME.geo(Position(east_m, north_m))
    degrees = round(geo.latitude_deg, 7), round(geo.longitude_deg, 7)
    return item(16, hold_s, 0, 0, None, *degrees, altitude_m, frame=3)


def gate(east_m: float, north_m: float, altitude_m: float = 25.0) -> Item:
    """Where a PX4 triggers its camera on a straight way."""
    return item(4501, 0, 1, 0, 0, *at(east_m, north_m)["params"][4:6], altitude_m, frame=3)


def begin(every_m: float = 20.0) -> Item:
    return item(206, every_m, 0, 1)


END = item(206, 0, 0, 1)  # QGroundControl takes a photo at the end of a transect too
PHOTO = item(2000, 0, 0, 1, None, None, None, None)
# Three transects of 90 m, turn-arounds 20 m beyond them: the way from one to the next is a rectangle.
TRANSECTS: list[tuple[Place, Place]] = [((0, 10), (0, 100)), ((20, 100), (20, 10)), ((40, 10), (40, 100))]
SPOTS = [
    *((0.0, 10.0 + along_m) for along_m in (0, 20, 40, 60, 80, 90)),
    *((20.0, 100.0 - along_m) for along_m in (0, 20, 40, 60, 80, 90)),
    *((40.0, 10.0 + along_m) for along_m in (0, 20, 40, 60, 80, 90)),
]


def transects(turn_m: float = 20.0) -> list[Item]:
    found = []
    for (east_m, from_m), (_, to_m) in TRANSECTS:
        beyond_m = math.copysign(turn_m, to_m - from_m)
        row = [at(east_m, from_m), begin(), at(east_m, to_m), END]
        found += [at(east_m, from_m - beyond_m), *row, at(east_m, to_m + beyond_m)] if turn_m else row
    return found


def written(
    tmp_path: Path,
    items: list[Item],
    *,
    mission: str = "photos = {}",
    photo_s: float = 0.5,
    heavy_s: float = 1.0,
    more: str = "",
    last: Item | None = None,
    fence: list[Place] | None = None,
    kind: str = "survey",
    speed_m_s: float = 4.0,
) -> Path:
    """A configuration, and beside it a plan with the items in a pattern."""
    corners = [FRAME.geo(Position(*place)) for place in fence or []]
    polygon = [[corner.latitude_deg, corner.longitude_deg] for corner in corners]
    pattern = {
        "type": "ComplexItem",
        "complexItemType": kind,
        "TransectStyleComplexItem": {"version": 2, "Items": items},
    }
    takeoff = item(22, 15, 0, 0, None, *HOME, 20, frame=3)
    plan = {
        "fileType": "Plan",
        "groundStation": "QGroundControl",
        "version": 1,
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [{"polygon": polygon, "inclusion": False, "version": 1}] if fence else [],
        },
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2, "vehicleType": 2, "firmwareType": 3, "hoverSpeed": speed_m_s, "cruiseSpeed": 15,
            "plannedHomePosition": [*HOME, None], "items": [takeoff, pattern, last or item(20)],
        },
    }  # fmt: skip
    (tmp_path / "field.plan").write_text(json.dumps(plan))
    return configured(tmp_path, mission=mission, photo_s=photo_s, heavy_s=heavy_s, more=more)


def configured(tmp_path: Path, **values: Any) -> Path:
    file = tmp_path / "drone.toml"
    file.write_text(
        CONFIG.format(**{"mission": "photos = {}", "photo_s": 0.5, "heavy_s": 1.0, "more": ""} | values)
    )
    return file
