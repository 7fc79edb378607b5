"""Worlds drawn at random, each from one seed: scenarios to compare policies in, as docs/worlds.md states them.

There are two families: worlds of any kind, and surveys, whose photos overlap. Each subject of a family draws from a
stream of its own: a change of one leaves the others as they are. The small worlds of `faults/worlds.py`, which test
promises, draw with the same functions and aim their faults at moments of a flight.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any, NamedTuple

from upwash.config.reading import Document

HELD_OUT = range(100_001, 101_001)  # no policy is tuned on these
LONGEST_FAULT_S = 10_000.0  # longer than any of these missions
MOVING_KINDS = ("off", "stuck", "slow", "flapping")
SERVER_KINDS = ("off", "stuck", "slow", "garbage", "wrong", "flapping", "full", "crash")
_LASTS_S = (2.0, 12.0, 40.0, 120.0, LONGEST_FAULT_S)
_STOP_S = 12.0  # about what a waypoint takes: faults begin within a mission
_SEEN_M = (0.9, 1.2)  # by a photo along the flight and across it, for each metre of altitude

Places = Sequence[tuple[float, float]]


class Times(NamedTuple):
    """Seconds of a photo on a drone's computer and on a server."""

    local_s: float
    remote_s: float


TODAYS = (  # computers with models, as docs/science.md names them
    Times(0.15, 0.2), Times(0.7, 0.2), Times(0.6, 1.7), Times(4.4, 1.7), Times(4.4, 3.7), Times(8.0, 1.0),
    Times(33.0, 1.7),
)  # fmt: skip


def stream(name: str, number: int) -> random.Random:
    """The random numbers of one subject of a world."""
    return random.Random(f"{name}/{number}")  # noqa: S311 - not for secrets


def between(chance: random.Random, least: float, most: float) -> float:
    """A number from a uniform distribution."""
    return round(chance.uniform(least, most), 2)


def spread(chance: random.Random, least: float, most: float) -> float:
    """A number from a log-uniform distribution."""
    return round(float(least * (most / least) ** chance.random()), 3)


def spell(chance: random.Random, from_s: float, lasts_s: Sequence[float]) -> dict[str, float]:
    """When a fault begins and ends, and the extra time of a slow target."""
    from_s = round(max(0.0, from_s), 4)
    took_s = chance.choice(lasts_s) * chance.uniform(0.5, 1.5)
    return {
        "from_s": from_s,
        "to_s": round(from_s + took_s, 4),
        "extra_s": round(chance.choice((0.05, 1.0, 5.0, 30.0)) * chance.uniform(0.5, 1.5), 3),
    }


def draw_world(seed: int, *, survey: bool = False) -> Document:
    """The scenario of the seed, from 1 on, as the tables of a TOML file; surveys have seeds of their own."""

    def of(subject: str) -> random.Random:
        return stream(f"survey {subject}" if survey else subject, seed)

    photo_s = between(of("camera"), 0.2, 1.5)
    mission = (_survey if survey else _mission)(of("mission"), photo_s)
    times = _times(of("times")) if survey else None
    service = _service(of("service"))
    if times:
        service["local_call_s"] = _calls_s(times.local_s)
    places = _places(mission)
    return {
        "seed": seed,
        "mission": mission,
        "vehicle": _vehicle(of("vehicle")),
        "camera": {"photo_s": photo_s},
        "network": {"radios": 2 if of("radios").random() < 0.15 else 1},
        "noise": _noise(of("noise")),
        "service": [service],
        "server": (servers := _servers(of("servers"), places, service, times)),
        "fault": _faults(of("faults"), servers, len(places)),
        **_answers(of("answers"), mission),
        **_heat(of("heat")),
        **_fleet(of("fleet"), mission, service),
    }


def _mission(chance: random.Random, photo_s: float) -> dict[str, Any]:
    kind = chance.choices(("field", "line", "places", "rows"), (40, 25, 15, 20))[0]
    mission: dict[str, Any] = {
        "mode": chance.choice(("light", "heavy")),
        "altitude_m": chance.choice((15.0, 20.0, 30.0, 60.0)),
        "ground_speed_m_s": between(chance, 3.0, 12.0),
    }
    if kind == "places":
        side_m = spread(chance, 100.0, 600.0)
        count = chance.randint(15, 50)
        places = [[round(chance.uniform(0.0, side_m), 1) for _ in range(2)] for _ in range(count)]
        return mission | {"waypoints_m": places}
    columns, rows = (
        (chance.randint(20, 80), 1) if kind == "line" else (chance.randint(4, 9), chance.randint(4, 9))
    )
    spacing_m = float(round(spread(chance, 12.0, 60.0)))
    mission["grid"] = {"columns": columns, "rows": rows, "spacing_m": spacing_m}
    if kind != "rows":
        return mission
    fastest_m_s = math.floor(100 * spacing_m / photo_s) / 100  # of the camera
    speed_m_s = min(mission["ground_speed_m_s"], fastest_m_s)
    return mission | {"photos": {"every_m": spacing_m}, "ground_speed_m_s": speed_m_s}


def _survey(chance: random.Random, photo_s: float) -> dict[str, Any]:
    """Rows whose photos overlap along the flight and across it."""
    altitude_m = chance.choice((30.0, 40.0, 60.0, 80.0))
    every_m, apart_m = (round(altitude_m * seen_m * chance.uniform(0.2, 0.4), 1) for seen_m in _SEEN_M)
    length_m = round(every_m * chance.randint(9, 39), 1)
    fastest_m_s = math.floor(100 * every_m / photo_s - 1e-6) / 100  # of the camera
    return {
        "mode": "heavy",
        "altitude_m": altitude_m,
        "ground_speed_m_s": min(between(chance, 3.0, 12.0), fastest_m_s),
        "photos": {"every_m": every_m},
        "waypoints_m": [
            [east_m, round(row * apart_m, 1)]
            for row in range(chance.randint(4, 16))
            for east_m in ((0.0, length_m) if row % 2 == 0 else (length_m, 0.0))
        ],
    }


def _times(chance: random.Random) -> Times:
    return Times(*(round(seconds * chance.uniform(0.8, 1.25), 3) for seconds in chance.choice(TODAYS)))


def _places(mission: Document) -> Places:
    if "waypoints_m" in mission:
        return [(east_m, north_m) for east_m, north_m in mission["waypoints_m"]]
    grid = mission["grid"]
    return [
        (grid["spacing_m"] * column, grid["spacing_m"] * row)
        for row in range(grid["rows"])
        for column in range(grid["columns"])
    ]


def _vehicle(chance: random.Random) -> dict[str, Any]:
    profile = chance.choices((None, "arducopter", "px4"), (60, 25, 15))[0]
    numbers = {
        "acceleration_m_s2": between(chance, 0.8, 3.0),
        "takeoff_s": between(chance, 4.0, 12.0),
        "return_and_land_s": between(chance, 8.0, 30.0),
    }
    return {"profile": profile} if profile else numbers


def _noise(chance: random.Random) -> dict[str, float]:
    most = {"call": 0.3, "leg": 0.05, "join": 0.3, "start": 0.3}
    return {name: between(chance, 0.01, limit) for name, limit in most.items()}


def _service(chance: random.Random) -> dict[str, Any]:
    heavy_s = spread(chance, 1.0, 15.0)
    return {
        "name": "detector",
        "request_bytes": chance.choice((50_000, 200_000, 425_000, 1_000_000)),
        "local_call_s": {"light": round(heavy_s * chance.uniform(0.2, 0.5), 3), "heavy": heavy_s},
        "local_first_extra_s": chance.choice((0.0, 0.0, 2.0)),
    }


def _calls_s(seconds: float) -> dict[str, float]:
    return {"light": seconds, "heavy": seconds}


def _servers(
    chance: random.Random, places: Places, service: Document, times: Times | None
) -> list[dict[str, Any]]:
    count = chance.choices((1, 2, 3, 4, 6, 10), (15, 25, 20, 20, 12, 8))[0]
    servers = [_server(chance, f"s{number}", places, service, times) for number in range(1, count + 1)]
    if count > 1 and chance.random() < 0.3:
        for server in servers:
            others = [other["name"] for other in servers if other is not server]
            server["truth"]["peers"] = [name for name in others if chance.random() < 0.7]
    return servers


def _server(
    chance: random.Random, name: str, places: Places, service: Document, times: Times | None
) -> dict[str, Any]:
    range_m = spread(chance, 100.0 if times else 30.0, 200.0)
    east_m, north_m = chance.choice(places)
    running_s, start_s = between(chance, 0.5, 6.0), between(chance, 0.0, 15.0)
    share = spread(chance, 0.03, 0.5) if chance.random() < 0.85 else between(chance, 0.5, 1.2)
    believed_s = {key: round(local_s * share, 3) for key, local_s in service["local_call_s"].items()}
    if times:
        believed_s = _calls_s(times.remote_s)
    truth: dict[str, Any] = {"slots": chance.choice((1, 2, "auto"))}
    if chance.random() < 0.4:  # it is not as believed
        factor = spread(chance, 0.5, 3.0)
        truth |= {
            "join_s": round(running_s * chance.uniform(0.5, 2.0), 2),
            "start_s": round(start_s * chance.uniform(0.5, 2.0), 2),
            "range_m": round(range_m * chance.uniform(0.6, 1.1), 1),
            "remote_call_s": {key: round(seconds * factor, 3) for key, seconds in believed_s.items()},
        }
    elif chance.random() < 0.35:
        truth |= {"radio": chance.choice(("disc54", "disc12")), "processing_s": believed_s}
    return {
        "name": name,
        "east_m": round(east_m + chance.uniform(-0.5, 0.5) * range_m, 1),
        "north_m": round(north_m + chance.uniform(-0.5, 0.5) * range_m, 1),
        "range_m": range_m,
        "check_running_s": running_s,
        "check_s": round(running_s + start_s, 2),
        "remote_call_s": believed_s,
        "truth": truth,
    }


def _faults(chance: random.Random, servers: Sequence[Document], stops: int) -> list[dict[str, Any]]:
    return [
        {
            "target": f"link:{server['name']}" if on_link else server["name"],
            "kind": chance.choice(MOVING_KINDS if on_link else SERVER_KINDS),
            **spell(chance, chance.uniform(0.0, _STOP_S * stops), _LASTS_S),
        }
        for _ in range(chance.choices(range(4), (55, 20, 15, 10))[0])
        for server, on_link in [(chance.choice(servers), chance.random() < 0.35)]
    ]


def _answers(chance: random.Random, mission: Document) -> dict[str, Any]:
    """Some answers demand an action, and the drone may fly on before it has them."""
    if chance.random() < (0.5 if "photos" in mission else 0.75):
        return {}
    return {
        "mission": mission | {"action_s": between(chance, 1.0, 10.0)},
        "event": {"probability": between(chance, 0.02, 0.2)},
        "policy": {"stay_or_go": chance.choice(("stay", "go", "learn"))},
    }


def _heat(chance: random.Random) -> dict[str, Any]:
    return {"heat": {"ambient_c": between(chance, 20.0, 50.0)}} if chance.random() < 0.25 else {}


def _fleet(chance: random.Random, mission: Document, service: Document) -> dict[str, Any]:
    """Other drones fly the same plan later, or a part of it, with faster or slower computers."""
    if chance.random() >= 0.15:
        return {}
    drones: list[dict[str, Any]] = []
    for number in range(1, chance.randint(2, 4) + 1):
        drone: dict[str, Any] = {"name": f"d{number}", "departs_s": between(chance, 0.0, 120.0)}
        if chance.random() < 0.3:
            factor = chance.uniform(0.5, 2.0)
            local_s = service["local_call_s"].items()
            drone["local_call_s"] = {key: round(seconds * factor, 3) for key, seconds in local_s}
        drones.append(drone)
    return {"drone": drones}
