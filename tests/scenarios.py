"""Small scenarios for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config

HEAVY_S = 10.0


def server(name: str, east_m: float, north_m: float, **other: Any) -> dict[str, Any]:
    """A server that makes heavy calls fourteen times faster."""
    return {
        "name": name,
        "east_m": east_m,
        "north_m": north_m,
        "range_m": 60.0,
        "remote_call_s": {"light": 0.3, "heavy": 0.7},
        **other,
    }


def fault(target: str, kind: str, **other: Any) -> dict[str, Any]:
    """Something that goes wrong all the time, unless told otherwise."""
    return {"target": target, "kind": kind, **other}


def scenario(
    *servers: dict[str, Any],
    faults: Sequence[dict[str, Any]] = (),
    columns: int = 6,
    rows: int = 3,
    mission: dict[str, Any] | None = None,
    **tables: Any,
) -> DroneConfig:
    """A survey with heavy calls over a small grid, with these servers and faults."""
    document = {
        "mission": {
            "mode": "heavy",
            "grid": {"columns": columns, "rows": rows, "spacing_m": 20.0},
            **(mission or {}),
        },
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": HEAVY_S}}],
        "server": list(servers),
        "fault": list(faults),
        **tables,
    }
    return drone_config(document, Path("scenario.toml"))
