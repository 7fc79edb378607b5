"""Whole worlds from one seed: missions, drones, servers, beliefs, truths, and what goes wrong when.

A scenario is drawn, flown once without faults, and then given faults that are aimed at moments of that flight: at a
network being joined, a daemon being asked, a service starting, a call, a reply, a farewell. A few seeds share one
scenario, each with faults of its own.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import Document
from upwash.config.world import Lie
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults import mission as probing
from upwash.lab.faults import seeking
from upwash.lab.observer import Observation
from upwash.lab.worlds import LONGEST_FAULT_S, MOVING_KINDS, SERVER_KINDS, between, spell, stream

_NOT_AIMED_AT = ("reached",)  # seen since worlds were first drawn: each seed keeps its faults
_TIMES = Path(__file__).parent / "believed_times.csv"
_USELESS_KINDS = ("hung", "poisoned", "unstartable")
_LIES = get_args(Lie)
_NO_MAP = "no such folder/demands.json"  # of demands: as before the first flight
_INCIDENTS = {  # how long each lasts, in seconds
    "diverted": (LONGEST_FAULT_S,),
    "home": (LONGEST_FAULT_S,),
    "jump": (2.0, 12.0, 40.0, LONGEST_FAULT_S),
    "restart": (0.3, 0.7, 2.0, 4.0),
    "impostor": (0.5, 5.0),
}
_LASTS_S = (0.02, 0.5, 2.0, 5.0, 12.0, 40.0, LONGEST_FAULT_S)  # of a fault
_MOVED_M, _RAISED_M = (20.0, 100.0), (6.0, 15.0)  # by an incident, over the ground and up or down
_ENDS_SHARE = 1 / 8  # of worlds: their returns hover or end at a rally point
_RALLY_M = (8.0, 300.0)  # from the start
_OBJECTS_APART_M = 14.0
_COMES_BACK_SHARE = 1 / 16  # of scenarios: their drones come back among servers whose power was cut meanwhile
_OVERLAP_M, _BEYOND_M = 15.0, 40.0
_CUT_S = (0.5, 2.0, 5.0)
_RESERVE_PERCENT, _SECOND_LASTS_S = 65.0, (60.0, 320.0)
SEEDS_PER_SCENARIO = 4  # so that most of the time goes into flights with faults
_MOMENTS = (
    "selected", "found_stopped", "found_running", "started", "deselected", "decided", "call", "leg", "arrived",
    "joined", "left", "sent", "asked", "answered", "served", "instance_started", "instance_ended", "admitted",
    "prepared", "held",
)  # fmt: skip


class FaultMoment(NamedTuple):
    """The time and kind of an event of a flight, and the name of its server or None."""

    t: float
    what: str
    server: str | None


def moment_of(event: Event | Observation) -> FaultMoment:
    """The moment of an event of a log, or of what an observer saw."""
    if isinstance(event, Observation):
        return FaultMoment(event.t, event.event, event.server)
    at = event.server if isinstance(event, (schema.ServerStep, schema.Joined, schema.Decided)) else None
    return FaultMoment(event.t, event.kind, at)


class _Aims(NamedTuple):
    """What faults are aimed at: servers, the moments of a calm flight that matter most to a fault, and all others."""

    servers: Sequence[str]
    moments: Sequence[FaultMoment]
    events: Sequence[FaultMoment]


class World:
    """The scenarios of some drones that share their servers; each seed adds faults of its own."""

    def __init__(self, seed: int) -> None:
        self._number = (seed - 1) // SEEDS_PER_SCENARIO
        chance = stream("world", self._number)
        document = _draft(chance, self._number)
        for name, rarity, change in _FEATURES:
            own = stream(name, self._number)
            if rarity is None or own.random() >= rarity:
                document = change(document, own)
        self._documents = [document]
        for number in range(2, 2 + chance.choices((0, 1, 2), (75, 19, 6))[0]):
            self._documents.append(_companion(self._documents[0], chance, number))
        self._documents = _with_fleet(self._documents, self._number)
        own = stream("stopped servers", self._number)
        self._comes_back = (
            own.random() <= _COMES_BACK_SHARE
            and len(document["server"]) > 1
            and "photos" not in document["mission"]
        )
        if self._comes_back:
            self._documents = [_coming_back(document, own) for document in self._documents]

    def calm(self) -> list[Document]:
        """The scenario of each drone, nothing going wrong."""
        return self._documents

    def faulty(self, seed: int, events: Sequence[FaultMoment]) -> list[Document]:
        """The same with the faults of the seed, aimed at moments of these events of the calm flight."""
        events = [event for event in events if event.what not in _NOT_AIMED_AT]
        names = [server["name"] for server in self._documents[0]["server"]]
        aims = _Aims(names, [event for event in events if event.what in _MOMENTS], events)
        chance = stream("faults", seed)
        faults = [_fault(chance, aims) for _ in range(chance.choices(range(6), (8, 30, 27, 18, 10, 7))[0])]
        if chance.random() < 0.15:
            faults += [_autopilot_fault(chance, aims) for _ in range(chance.randint(1, 2))]
        for name, share, drawn in _MORE_FAULTS:
            own = stream(name, seed)
            if own.random() <= share:
                faults += drawn(own, aims)
        if self._comes_back:
            faults += _power_cuts(stream("power cuts", seed), aims)
        documents = self._documents
        own = stream("ends of returns", seed)
        if own.random() <= _ENDS_SHARE:
            faults += _ends_of_returns(own)
            documents = _with_reserve(documents, own, events[-1].t if events else 100.0)
        if any(fault["kind"] == "battery" for fault in faults):
            documents = [_changed(each, mission={"reserve_percent": _RESERVE_PERCENT}) for each in documents]
        return [{**document, "fault": faults} for document in documents]


def _changed(document: Document, *, servers: Document | None = None, **tables: Document) -> Document:
    """The document with other values in some tables, and in the tables of all servers."""
    changed: Document = {name: {**document.get(name, {}), **values} for name, values in tables.items()}
    if servers is not None:
        changed["server"] = [{**server, **servers} for server in document["server"]]
    return {**document, **changed}


def _coming_back(document: Document, chance: random.Random) -> Document:
    """The ranges of the servers overlap around the places, which the drone leaves once and comes back to.

    Their networks are joined at once, as by wire, and their services start slowly.
    """
    places = document["mission"]["waypoints_m"]
    east_m, north_m = places[0]
    reach_m = max(math.dist(places[0], place) for place in places) + 2 * _OVERLAP_M
    servers = [
        {
            **server,
            "east_m": round(east_m + chance.uniform(-_OVERLAP_M, _OVERLAP_M), 1),
            "north_m": round(north_m + chance.uniform(-_OVERLAP_M, _OVERLAP_M), 1),
            "range_m": round(reach_m + chance.uniform(0.0, _OVERLAP_M), 1),
            "check_running_s": 0.1,
            "check_s": between(chance, 3.0, 12.0),
            "truth": {
                **server["truth"],
                "join_s": between(chance, 0.02, 0.1),
                "start_s": 3.0,
                "leave_s": 0.0,
            },
        }
        for server in document["server"]
    ]
    away = [round(east_m + reach_m + 2 * _OVERLAP_M + _BEYOND_M, 1), north_m]
    policy = {"name": "look-ahead", "idle_s": 180.0}
    flown = _changed(document, mission={"waypoints_m": [*places, away, *places]}, policy=policy)
    return {**flown, "server": servers}


def _power_cuts(chance: random.Random, aims: _Aims) -> list[dict[str, Any]]:
    """All servers lose their power for a moment, most of them after the drone has left one."""
    left = [event.t for event in aims.events if event.what == "deselected"] or [chance.uniform(0.0, 100.0)]
    from_s = round(chance.choice(left) + between(chance, 0.0, 5.0), 4)
    to_s = round(from_s + chance.choice(_CUT_S), 4)
    return [{"target": name, "kind": "power-cut", "from_s": from_s, "to_s": to_s} for name in aims.servers]


def configs(documents: Sequence[Document]) -> list[DroneConfig]:
    """The scenarios that the documents say."""
    return [drone_config(document, Path("world.toml")) for document in documents]


def _draft(chance: random.Random, number: int) -> Document:
    """A scenario, without faults."""
    mode, places, services = chance.choice(("light", "heavy")), _places(chance), _services(chance)
    document: dict[str, Any] = {
        "name": "d1",
        "seed": number,
        "mission": {
            "program": f"{probing.__name__}:{'look_and_read' if len(services) > 1 else 'look'}",
            "mode": mode,
            "altitude_m": chance.choice((5.0, 20.0, 60.0)),
            "ground_speed_m_s": between(chance, 3.0, 15.0),
            "waypoints_m": places,
        },
        "vehicle": _vehicle(chance),
        "autopilot": {"on_failure": chance.choice(("return", "land", "hold"))},
        "camera": {"photo_s": chance.choice((0.0, 0.2, 1.0))},
        "policy": _policy(chance),
        "service": services,
        "server": _servers(chance, places, services),
    }
    if chance.random() < 0.3:
        document["noise"] = {"call": between(chance, 0.0, 0.4), "leg": between(chance, 0.0, 0.1)}
    if chance.random() < 0.1:
        document["heat"] = {"ambient_c": between(chance, 20.0, 60.0)}
    if chance.random() < 0.3:
        document["policy"]["hedge"] = {
            "after": chance.choice(("p50", "p80", "p95")),
            "budget": chance.choice((0.02, 0.1, 0.5)),
        }
    return document


def _vehicle(chance: random.Random) -> dict[str, Any]:
    if chance.random() < 0.25:
        return {"profile": "arducopter"}
    return {
        "acceleration_m_s2": between(chance, 0.5, 5.0),
        "takeoff_s": between(chance, 0.0, 12.0),
        "return_and_land_s": between(chance, 1.0, 16.0),
    }


def _policy(chance: random.Random) -> dict[str, Any]:
    return {
        "name": chance.choices(
            ("location-aware", "look-ahead", "opportunistic", "local-only"), (36, 36, 25, 3)
        )[0],
        "gain_switch": chance.choice((0.0, 0.1, 0.25, 0.5)),
        "gain_wait": chance.choice((0.0, 0.1, 0.25, 0.6)),
        "period_s": chance.choice((0.5, 1.0, 2.0, 3.0)),
        "blacklist_s": chance.choice((1.0, 5.0, 20.0, 60.0)),
        "idle_s": chance.choice((0.0, 10.0, 180.0)),
        "retry_s": chance.choice((0.0, 20.0, 300.0)),
    }


def _services(chance: random.Random) -> list[dict[str, Any]]:
    spotter = {
        "name": "spotter",
        "program": f"{probing.__name__}:Spotter",
        "request_bytes": chance.choice((1_000, 100_000, 425_000)),
        "local_call_s": {"light": between(chance, 0.5, 4.0), "heavy": between(chance, 3.0, 10.0)},
        "local_first_extra_s": chance.choice((0.0, 0.0, 2.0)),
    }
    gauge = {
        "name": "gauge",
        "program": f"{probing.__name__}:Gauge",
        "request_bytes": 10_000,
        "local_call_s": {"": between(chance, 0.3, 6.0)},
    }
    return [spotter, gauge] if chance.random() < 0.35 else [spotter]


def _servers(
    chance: random.Random, places: Sequence[Sequence[float]], services: Sequence[Document]
) -> list[dict[str, Any]]:
    count = chance.choices((1, 2, 3, 4), (25, 40, 25, 10))[0]
    return [_server(chance, f"s{number}", places, services) for number in range(1, count + 1)]


def _server(
    chance: random.Random, name: str, places: Sequence[Sequence[float]], services: Sequence[Document]
) -> dict[str, Any]:
    east_m, north_m = chance.choice(places)
    check_running_s = between(chance, 0.1, 6.0)
    server = {
        "name": name,
        "east_m": round(east_m + chance.uniform(-60, 60), 1),
        "north_m": round(north_m + chance.uniform(-60, 60), 1),
        "range_m": between(chance, 10.0, 160.0),
        "network": "shared" if chance.random() < 0.1 else name,
        "check_running_s": check_running_s,
        "check_s": round(check_running_s + chance.uniform(0.0, 12.0), 2),
        "remote_call_s": _remote_s(chance, services, 0.02, 0.8 if chance.random() < 0.85 else 1.5),
    }
    truth: dict[str, Any] = {"slots": chance.choice((1, 1, 2))}
    if chance.random() < 0.5:  # it is not as believed
        truth["join_s"] = between(chance, 0.0, 12.0)
        truth["start_s"] = between(chance, 0.0, 20.0)
        truth["remote_call_s"] = _remote_s(chance, services, 0.02, 2.0)
    elif chance.random() < 0.3:
        truth["radio"] = chance.choice(("disc54", "disc12"))
        truth["processing_s"] = _remote_s(chance, services, 0.01, 0.3)
    if chance.random() < 0.08:
        names = [service["name"] for service in services]
        truth["images"] = chance.sample(names, chance.randrange(len(names)))
    return {**server, "truth": truth}


def _remote_s(
    chance: random.Random, services: Sequence[Document], least: float, most: float
) -> dict[str, dict[str, float]]:
    return {
        service["name"]: {
            key: round(local_s * chance.uniform(least, most), 3)
            for key, local_s in service["local_call_s"].items()
        }
        for service in services
    }


def _with_peers(document: Document, chance: random.Random) -> Document:
    """Servers are peers; some relations are one-sided."""
    names = [server["name"] for server in document["server"]]
    for server in document["server"] if len(names) > 1 else ():
        others = [name for name in names if name != server["name"]]
        server["truth"]["peers"] = [name for name in others if chance.random() < 0.7]
    return document


def _with_slow_first_calls(document: Document, chance: random.Random) -> Document:
    """First calls are slow, and the drone is patient with them."""
    document["policy"]["patient_first_call"] = True
    for server in document["server"]:
        server["truth"]["first_extra_s"] = chance.choice((0.0, 1.0, 4.0))
    return document


def _with_busy_radios(document: Document, chance: random.Random) -> Document:
    """Leaving a network takes time, and joining one slows the drone's own services."""
    for server in document["server"]:
        server["truth"]["leave_s"] = chance.choice((0.0, 0.5, 3.0))
    for service in document["service"]:
        service["local_joining_slowdown"] = {
            key: chance.choice((0.0, 0.2, 1.0)) for key in service["local_call_s"]
        }
    return document


def _with_probing(document: Document, chance: random.Random) -> Document:
    """In half of the worlds failed servers are left alone, in the others probed; some policies use their default."""
    policy = document["policy"]
    if chance.random() < 0.5:
        policy.setdefault("hedge", False)
        return document
    del policy["blacklist_s"]
    if chance.random() < 0.7:
        first_s = chance.choice((0.2, 0.5, 2.0))
        policy["probe"] = {"first_s": first_s, "longest_s": first_s * chance.choice((1, 2, 10))}
        policy.setdefault("hedge", False)
    return document


def _with_eager_hedges(document: Document, _: random.Random) -> Document:
    """Half of all remote calls are hedged, within a small budget."""
    return _changed(document, policy={"hedge": {"after": "p50", "budget": 0.05}})


def _with_pending_calls(document: Document, chance: random.Random) -> Document:
    """With one service the drones may fly on before they have an answer."""
    if len(document["service"]) > 1 or _has_peers(document):
        return document
    return _changed(
        document, mission={"program": f"{probing.__name__}:look_later"}, policy=_that_goes(document, chance)
    )


def _has_peers(document: Document) -> bool:
    """Whether servers are peers: slots that peers hold for drones that wait for answers are too rare to test."""
    return any("peers" in server["truth"] for server in document["server"])


_ACT_WITHIN_S = (0.0, 0.0, 20.0, 40.0)


def _that_goes(document: Document, chance: random.Random) -> Document:
    """The policy of a drone that may fly on before answers; in half of the worlds by the place.

    In a sixth of the worlds it acts at once, and in another in time.
    """
    policy: dict[str, Any] = {"stay_or_go": chance.choice(("stay", "go", "learn"))}
    if (number := document["seed"] % 12) < len(_ACT_WITHIN_S):
        policy["act_within_s"] = _ACT_WITHIN_S[number]
    return policy if document["seed"] % 2 else {**policy, "demand_map": _NO_MAP}


def _with_radios(document: Document, chance: random.Random) -> Document:
    return {**document, "network": {"radios": 2}} if chance.random() < 1 / 3 else document


def _with_rows(document: Document, chance: random.Random) -> Document:
    if len(document["service"]) > 1:
        program = chance.choices(("look_and_read_on_the_move", "look_and_read"), (5, 2))[0]
    else:
        program = chance.choices(("look_on_the_move", "look_later", "look"), (5, 3, 2))[0]
    photos = {
        "every_m": chance.choice((15.0, 20.0, 33.0)),
        "order": chance.choice(("oldest", "newest")),
        "at_most": chance.choice((1, 2, 3, 5, 100)),
    }
    flown = {"program": f"{probing.__name__}:{program}", "waypoints_m": _rows(chance), "photos": photos}
    return _changed(document, mission=flown, policy=_that_goes(document, chance))


def _with_two_answers(document: Document, chance: random.Random) -> Document:
    """The drones hear a first answer of their own, and perhaps a better one of a server."""
    spotter = document["service"][0]
    light_s, heavy_s = (spotter["local_call_s"][mode] for mode in ("light", "heavy"))
    if len(document["service"]) > 1 or light_s >= heavy_s or _has_peers(document):
        return document
    program = "look_twice_on_the_move" if "photos" in document["mission"] else "look_twice_later"
    within_s = light_s + chance.choice((1.0, 5.0, 15.0, 40.0))
    twice = {**spotter, "two_answers": {"first": "light", "within_s": round(within_s, 2)}}
    mission = {"mode": "heavy", "program": f"{probing.__name__}:{program}"}
    return {**_changed(document, mission=mission), "service": [twice]}


def _rows(chance: random.Random) -> list[list[float]]:
    """The starts and ends of one to three rows, side by side or anywhere."""
    count = chance.choice((1, 2, 2, 3))
    if chance.random() < 0.5:
        length_m, apart_m = between(chance, 10.0, 120.0), chance.choice((10.0, 20.0, 40.0))
        return [
            [length_m if (number + end) % 2 else 0.0, apart_m * number]
            for number in range(count)
            for end in (0, 1)
        ]
    return [[round(chance.uniform(0, 120), 1), round(chance.uniform(0, 120), 1)] for _ in range(2 * count)]


def _with_only_servers(document: Document, chance: random.Random) -> Document:
    policy = {"detour_s": chance.choice((0.0, 20.0, 120.0))}
    surveyor = {
        "name": "surveyor",
        "program": f"{probing.__name__}:Surveyor",
        "request_bytes": chance.choice((1_000, 100_000, 425_000)),
        "waiting_bytes": chance.choice((20, 200, 1_000_000)),
    }
    servers = [_surveying(server, chance) for server in document["server"]]
    flown = _changed(document, mission={"program": f"{probing.__name__}:ask_servers"}, policy=policy)
    return {**flown, "service": [surveyor], "server": servers}


def _surveying(server: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    call_s = between(chance, 0.1, 6.0)
    truth = {name: value for name, value in server["truth"].items() if name != "images"}
    for times in ("remote_call_s", "processing_s"):
        if times in truth:
            truth[times] = {"surveyor": round(call_s * chance.uniform(0.5, 2.0), 3)}
    return {**server, "remote_call_s": {"surveyor": call_s}, "truth": truth}


def _with_less_to_send(document: Document, chance: random.Random) -> Document:
    """A part makes requests smaller before they are sent, as far as the user allows its loss."""
    spotter, *others = document["service"]
    if spotter["name"] != "spotter":
        return document
    request_bytes = max(100_000, spotter["request_bytes"])
    part = {
        "takes_s": chance.choice((0.0, 0.05, 0.5, 1.0)),
        "request_bytes": round(request_bytes * chance.choice((0.05, 0.1, 0.3, 1.2))),
        "loss": chance.choice((0.0, 0.01, 0.05)),
    }
    servers = [
        {**server, "bandwidth_bit_s": chance.choice((0.3e6, 1e6, 4e6))} for server in document["server"]
    ]
    smaller = {**spotter, "request_bytes": request_bytes, "before_sending": part}
    flown = _changed(document, policy={"most_loss": chance.choice((0.0, 0.02, 0.1, 0.1))})
    return {**flown, "service": [smaller, *others], "server": servers}


def _with_deadlines(document: Document, chance: random.Random) -> Document:
    """Calls have a deadline that the drone can keep, and a second server for those that the first answers late."""
    spotter, *others = document["service"]
    if spotter["name"] != "spotter" or "two_answers" in spotter or "photos" in document["mission"]:
        return document
    within_s = chance.choice((1.0, 1.2, 3.0)) * max(spotter["local_call_s"].values())
    deadline = {"s": within_s, "p": 0.99, "extra": chance.choice((0.1, 0.5, 1.0))}
    believed, hedge = {"times_csv": str(_TIMES)}, {"budget": 1.0}
    flown = _changed(document, servers=believed, policy={"hedge": hedge}, network={"radios": 2})
    return {**flown, "service": [{**spotter, "deadline": deadline}, *others]}


def _with_objects(document: Document, chance: random.Random) -> Document:
    mission, (spotter, *others) = document["mission"], document["service"]
    changed = {"two_answers", "before_sending", "deadline"} & spotter.keys()
    if others or changed or not mission["program"].startswith(f"{probing.__name__}:look"):
        return document
    near_m = 0.3 * mission["altitude_m"]
    objects = list[dict[str, Any]]()
    for place in mission["waypoints_m"] * 3:
        east_m, north_m = (round(each + chance.uniform(-near_m, near_m), 1) for each in place)
        label = chance.choice(("deer", "stone"))
        away_m = (math.hypot(each["east_m"] - east_m, each["north_m"] - north_m) for each in objects)
        if min(away_m, default=math.inf) > _OBJECTS_APART_M:
            objects.append({"label": label, "east_m": east_m, "north_m": north_m})
    flown = {"program": f"{seeking.__name__}:look_for_objects"}
    seen = _changed(document, mission=flown, camera={"fov_deg": 62.2}, event={"objects": objects})
    return {**seen, "service": [{**spotter, "program": f"{seeking.__name__}:Spotter"}]}


_FEATURES: tuple[tuple[str, float | None, Callable[[Document, random.Random], Document]], ...] = (
    # the stream of a feature, the share of worlds without it unless it draws that itself, and what it changes
    ("peers", 0.5, _with_peers),
    ("first calls", 0.7, _with_slow_first_calls),
    ("busy radios", 0.85, _with_busy_radios),
    ("probing", None, _with_probing),
    ("hedges", 0.93, _with_eager_hedges),
    ("pending", 0.6, _with_pending_calls),
    ("radios", None, _with_radios),
    ("rows", 0.8, _with_rows),
    ("two answers", 0.75, _with_two_answers),
    ("only servers", 0.88, _with_only_servers),
    ("less to send", 0.7, _with_less_to_send),
    ("deadlines", 0.8, _with_deadlines),
    ("objects", 0.75, _with_objects),
)


def _places(chance: random.Random) -> list[list[float]]:
    count = chance.choices((1, 2, 3, 4, 6), (5, 25, 35, 25, 10))[0]
    if chance.random() < 0.5:
        columns, spacing_m = chance.choice((1, 2, 3)), chance.choice((10.0, 20.0, 40.0))
        return [[spacing_m * (number % columns), spacing_m * (number // columns)] for number in range(count)]
    return [[round(chance.uniform(0, 120), 1), round(chance.uniform(0, 120), 1)] for _ in range(count)]


def _companion(document: Document, chance: random.Random, number: int) -> Document:
    """Another drone with its own mission and seed, among the same servers."""
    places = _places(chance)
    if "photos" in document["mission"]:
        places = _rows(stream("rows of a companion", document["seed"] * 10 + number))
    mission = {"waypoints_m": places, "ground_speed_m_s": between(chance, 3.0, 15.0)}
    seed = document["seed"] + number * 1_000_000_007
    return {**_changed(document, mission=mission), "name": f"d{number}", "seed": seed}


def _with_fleet(documents: list[Document], number: int) -> list[Document]:
    """In some worlds more drones take short turns at servers with few slots, or with measured ones."""
    chance = stream("fleet", number)
    if chance.random() < 0.9:
        return documents
    document = documents[0]
    servers = [
        {**server, "truth": {**server["truth"], "slots": slots, "turn_s": between(chance, 12.0, 24.0)}}
        for server in document["server"]
        for slots in [chance.choice((1, 1, 2, "auto"))]
    ]
    fleet = [{**document, "server": servers} for document in documents]
    more = range(len(fleet) + 1, len(fleet) + 1 + chance.randint(1, 5))
    return fleet + [_companion(fleet[0], chance, number) for number in more]


def _fault(chance: random.Random, aims: _Aims) -> dict[str, Any]:
    server = chance.choice(aims.servers)
    from_s = chance.uniform(0.0, 100.0)
    if aims.moments and chance.random() < 0.85:
        moment = chance.choice(aims.moments)
        server = moment.server or server
        from_s = moment.t + chance.choice((0.0, chance.uniform(-0.01, 0.01), chance.uniform(-3.0, 3.0)))
    on_link = chance.random() < 0.35
    return {
        "target": f"link:{server}" if on_link else server,
        "kind": chance.choice(MOVING_KINDS if on_link else SERVER_KINDS),
        **spell(chance, from_s, _LASTS_S),
    }


def _about(chance: random.Random, aims: _Aims) -> float:
    return (chance.choice(aims.events).t if aims.events else 0.0) + chance.uniform(-1.0, 1.0)


def _autopilot_fault(chance: random.Random, aims: _Aims) -> dict[str, Any]:
    from_s = _about(chance, aims)
    return {"target": "autopilot", "kind": chance.choice(MOVING_KINDS), **spell(chance, from_s, _LASTS_S)}


def _takeovers(chance: random.Random, aims: _Aims) -> list[dict[str, Any]]:
    """A pilot or a fail-safe takes the vehicle, at any moment."""
    kinds = chance.choice((["pilot"], ["fail-safe"], ["fail-safe", "pilot"]))
    return [{**_autopilot_fault(chance, aims), "kind": kind} for kind in kinds]


def _incidents(chance: random.Random, aims: _Aims) -> list[dict[str, Any]]:
    """Others move the vehicle or its home, its position jumps, or its autopilot restarts."""
    faults = []
    for _ in range(chance.choice((1, 1, 2))):
        kind = chance.choice(tuple(_INCIDENTS))
        from_s = round(max(0.0, _about(chance, aims)), 4)
        lasts_s = round(chance.choice(_INCIDENTS[kind]) * chance.uniform(0.5, 1.5), 4)
        angle, far_m = chance.uniform(0.0, math.tau), chance.uniform(*_MOVED_M)
        up_m = chance.choice((-1, 1)) * chance.uniform(*_RAISED_M)
        moved_m = [round(each, 2) for each in (far_m * math.cos(angle), far_m * math.sin(angle), up_m)]
        spell_s = {"from_s": from_s, "to_s": round(from_s + lasts_s, 4)}
        faults.append({"target": "autopilot", "kind": kind, **spell_s, "moved_m": moved_m})
    return faults


def _of_servers(chance: random.Random, aims: _Aims, *, most: int) -> Iterator[dict[str, Any]]:
    for _ in range(chance.randint(1, most)):
        fault = _fault(chance, aims)
        yield {**fault, "target": fault["target"].removeprefix("link:")}


def _lies(chance: random.Random, aims: _Aims) -> list[dict[str, Any]]:
    faults = _of_servers(chance, aims, most=3)
    return [{**fault, "kind": "lying", "lie": chance.choice(_LIES)} for fault in faults]


def _useless_instances(chance: random.Random, aims: _Aims) -> list[dict[str, Any]]:
    """Instances hang, raise for good, or do not start."""
    return [{**fault, "kind": chance.choice(_USELESS_KINDS)} for fault in _of_servers(chance, aims, most=2)]


def _ends_of_returns(chance: random.Random) -> list[dict[str, Any]]:
    """Returns hover, or end at one of some rally points."""
    faults = []
    for kind in chance.choice((["hovers"], ["rally"], ["rally", "rally"], ["hovers", "rally"])):
        angle, far_m = chance.uniform(0.0, math.tau), chance.uniform(*_RALLY_M)
        moved_m = [round(far_m * math.cos(angle), 1), round(far_m * math.sin(angle), 1), 0.0]
        faults.append({"target": "autopilot", "kind": kind, "moved_m": moved_m})
    return faults


def _with_reserve(documents: list[Document], chance: random.Random, calm_s: float) -> list[Document]:
    """In half of these worlds the battery may end the mission, before the end of the calm flight or after it."""
    if chance.random() < 0.5:
        return documents
    endurance_s, reserve_s = calm_s * between(chance, 0.6, 2.0), chance.choice((5.0, 20.0, 60.0))
    vehicle = {"endurance_s": round(endurance_s + reserve_s, 1)}
    return [_changed(each, mission={"reserve_s": reserve_s}, vehicle=vehicle) for each in documents]


def _second_batteries(chance: random.Random, _: _Aims) -> list[dict[str, Any]]:
    """A second battery drains faster than the mission lasts."""
    return [{"target": "autopilot", "kind": "battery", "lasts_s": between(chance, *_SECOND_LASTS_S)}]


_MORE_FAULTS = (  # the stream of each, and the share of worlds with it
    ("takeovers", 0.1, _takeovers),
    ("incidents", 1 / 8, _incidents),
    ("lies", 1 / 3, _lies),
    ("useless instances", 1 / 8, _useless_instances),
    ("second battery", 1 / 16, _second_batteries),
)
