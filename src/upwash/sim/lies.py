"""What a lying server says: an honest reply, and what becomes of it, in several ways.

- `elsewhere`: its services run, it says, at addresses that are not its own
- `unwanted`: services and peers by the hundred that nobody asked for
- `oversized`: more entries and longer texts than any field can have
- `lease`: one that is tiny, negative, endless or no number
- `types`: results of other types than the service's
- `faults`: exceptions that the service never raised, also such as upwash itself raises
- `control`: control characters wherever there is text
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from upwash.config import Lie
from upwash.errors import Refused
from upwash.rpc.protocol import AVAILABILITY, HOLD, PREPARE, START

_ELSEWHERE = (
    "nobody.invalid:1", "dns:///nobody.invalid:1", "xds:///nobody", "unix:/run/nobody.sock", "unix-abstract:nobody",
    ":0", ":70000", "ipv4:10.0.0.1:1", "",
)  # fmt: skip
_LEASES_S = (0.003, math.nan, -1.0, math.inf, 1e300, 0.0)
_MANY = 300  # more than any field holds
_LONG = "x" * 10_000
_ESCAPES = "\x1b[2J\x1b]0;nobody\x07\x9b31m\u202e\u2066\r\nupwash: all is well"
_RESULTS: tuple[dict[str, Any], ...] = (
    {"value": {"neither": "this"}}, {"value": [[[]]]}, {"value": "text"}, {"value": math.nan}, {"fault": 7}, {},
)  # fmt: skip
_FAULTS = (
    "upwash.drone.flight:AutopilotOverruled", "upwash.errors:MissionStopped", "upwash.drone.mission:MissionFailed",
    "builtins:SystemExit", "builtins:KeyboardInterrupt", "builtins:MemoryError", "nobody:Known", _ESCAPES,
)  # fmt: skip

Reply = dict[str, Any]
T = TypeVar("T")


def as_daemon(lie: Lie, path: str, reply: bytes, *, number: int) -> bytes:
    """What a server says instead of its daemon's honest reply, in the way of that number."""
    tell = _OF_DAEMON.get((lie, path))
    return msgspec.msgpack.encode(tell(msgspec.msgpack.decode(reply), number)) if tell else reply


def as_instance(lie: Lie, reply: bytes, *, number: int) -> bytes:
    """What a server says instead of its service's honest reply; may raise Refused."""
    match lie:
        case "types":
            return msgspec.msgpack.encode(_one_of(_RESULTS, number))
        case "faults":
            return msgspec.msgpack.encode({"fault": {"type": _one_of(_FAULTS, number), "message": _ESCAPES}})
        case "control":
            raise Refused(_ESCAPES)
    return reply


def _one_of(ways: Sequence[T], number: int) -> T:
    return ways[number % len(ways)]


def _elsewhere(reply: Reply, number: int) -> Reply:
    endpoints = dict.fromkeys(reply.get("endpoints", {}), _one_of(_ELSEWHERE, number))
    return {**reply, "endpoints": endpoints}


def _started_elsewhere(_: Reply, number: int) -> Reply:
    return {"endpoint": _one_of(_ELSEWHERE, number)}


def _unwanted(reply: Reply, _: int) -> Reply:
    strangers = [f"stranger-{number}" for number in range(100)]
    return {
        **reply,
        "endpoints": {**reply.get("endpoints", {}), **dict.fromkeys(strangers, ":1")},
        "peers": [*reply.get("peers", []), *strangers],
    }


def _oversized(reply: Reply, number: int) -> Reply:
    names = [f"stranger-{each}" for each in range(_MANY)]
    ways: tuple[Reply, ...] = (
        {"endpoints": dict.fromkeys(names, ":1")},
        {"endpoints": dict.fromkeys(reply.get("endpoints", {}), f":{_LONG}")},
        {"available": False, "reason": _LONG},
        {"peers": names},
        {"peers": [_LONG]},
    )
    return reply | _one_of(ways, number)


def _started_oversized(_: Reply, number: int) -> Reply:
    ways: tuple[Reply, ...] = ({"endpoint": f":{_LONG}"}, {"reason": _LONG})
    return _one_of(ways, number)


def _held_oversized(_: Reply, __: int) -> Reply:
    return {"held": False, "reason": _LONG}


def _leased(reply: Reply, number: int) -> Reply:
    return {**reply, "lease_s": _one_of(_LEASES_S, number)}


def _controlling(reply: Reply, number: int) -> Reply:
    ways: tuple[Reply, ...] = (
        {"available": False, "reason": _ESCAPES},
        {"endpoints": dict.fromkeys(reply.get("endpoints", {}), f":1{_ESCAPES}")},
        {_ESCAPES: _ESCAPES, "peers": [_ESCAPES]},
    )
    return reply | _one_of(ways, number)


def _started_controlling(_: Reply, number: int) -> Reply:
    ways: tuple[Reply, ...] = ({"reason": _ESCAPES}, {"endpoint": _ESCAPES})
    return _one_of(ways, number)


def _held_controlling(_: Reply, __: int) -> Reply:
    return {"held": False, "reason": _ESCAPES}


_OF_DAEMON: Mapping[tuple[Lie, str], Callable[[Reply, int], Reply]] = {
    ("elsewhere", AVAILABILITY): _elsewhere,
    ("elsewhere", START): _started_elsewhere,
    ("unwanted", AVAILABILITY): _unwanted,
    ("oversized", AVAILABILITY): _oversized,
    ("oversized", START): _started_oversized,
    ("oversized", PREPARE): _held_oversized,
    ("oversized", HOLD): _held_oversized,
    ("lease", AVAILABILITY): _leased,
    ("control", AVAILABILITY): _controlling,
    ("control", START): _started_controlling,
    ("control", PREPARE): _held_controlling,
    ("control", HOLD): _held_controlling,
}
