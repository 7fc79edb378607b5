"""Where more servers would help most, by the predicted mission time."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from upwash.config import Document, DroneConfig, waypoints
from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.lab.campaigns.campaign import Fly
from upwash.preflight.prediction import AS_CONFIGURED, changed, predict

STEPS = 6  # candidates along each side of the field


class SuggestedPlace(Struct, frozen=True, kw_only=True):
    """Where one more server helps most, and the mission time that is predicted with it and those before it."""

    server: str
    east_m: float
    north_m: float
    mission_time_s: float


def missions_to_place(servers: int) -> int:
    """How many missions `place` flies at most."""
    return servers * (STEPS**2 + 1)


def place(
    document: Document,
    config: DroneConfig,
    file: Path,
    *,
    servers: int,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
) -> tuple[list[SuggestedPlace], Document]:
    """Puts one server after the other where the mission is then fastest; also returns the document with them.

    Each is like the first server of the file, and is tried at STEPS by STEPS places over the field, with one mission
    each and no noise. It stops early if one more server would gain nothing. Raises UsageError without a server in the
    file, and if no mission is completed.
    """
    if not config.servers:
        raise UsageError("--place needs one [[server]] in the file: the servers to be placed are like it")
    field = candidates([waypoint.position for waypoint in waypoints(config.mission)])
    placed: list[SuggestedPlace] = []
    for name in itertools.islice(_free_names(config), servers):
        trials = {str(index): _with_server(document, name, at) for index, at in enumerate(field)}
        documents = {AS_CONFIGURED: document, **trials}
        found = predict(
            {case: _silent(document) for case, document in documents.items()},
            file,
            seeds=1,
            fly=fly,
            flown=flown,
        )
        times_s = {one.case: one.mission_time_s for one in found if one.mission_time_s is not None}
        if not times_s:
            raise UsageError(f"no place can be compared: no mission is completed: {found[0].failures[0]}")
        best = min(times_s, key=times_s.__getitem__)  # as it is where no place is better: that comes first
        if best == AS_CONFIGURED:
            break
        at = field[int(best)]
        placed.append(
            SuggestedPlace(server=name, east_m=at.east_m, north_m=at.north_m, mission_time_s=times_s[best])
        )
        document = trials[best]
    return placed, document


def candidates(places: Sequence[Position]) -> list[Position]:
    """The middles of equal parts of the field that the places span."""
    return [
        Position(east_m, north_m)
        for east_m, north_m in itertools.product(
            sorted(set(_middles([place.east_m for place in places]))),
            sorted(set(_middles([place.north_m for place in places]))),
        )
    ]


def _middles(values_m: Sequence[float]) -> Iterator[float]:
    low_m, high_m = min(values_m), max(values_m)
    for step in range(STEPS):
        yield low_m + (step + 0.5) * (high_m - low_m) / STEPS


def _with_server(document: Document, name: str, at: Position) -> Document:
    other = copy.deepcopy(document)
    server = copy.deepcopy(other["server"][0])
    for key in ("latitude_deg", "longitude_deg", "address", "network"):
        server.pop(key, None)
    other["server"].append({**server, "name": name, "east_m": at.east_m, "north_m": at.north_m})
    return other


def _silent(document: Document) -> Document:
    """Without noise, which would favour a lucky place."""
    other = changed(document)
    other.pop("noise", None)
    return other


def _free_names(config: DroneConfig) -> Iterator[str]:
    taken = {server.name for server in config.servers}
    return (name for name in (f"new{number}" for number in itertools.count(1)) if name not in taken)
