"""Logs that nobody flew, for tests: any events that the format allows, with names and numbers that break readers."""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from typing import Any

from msgspec import inspect

from upwash.eventlog import schema
from upwash.eventlog.log import decode

_TAG = "</script><!--<img src=x onerror=alert(1)>"
NAMES = [
    "__proto__", "constructor", "toString", "hasOwnProperty", "local", "", " ", "s1", "s2", "s10", _TAG, "&lt;b&gt;",
    "\u2028\u2029", "\u202eevig\u200f", "\ud800", "\udc00x", "\x00\x1b[31m", "]]>", "-->", "'\"`${alert(1)}",
    "[server][state]", "=cmd|' /C calc'!A0", "\ufeff", "e\u0301" * 40, "W" * 10_000, "🛸" * 300,
]  # fmt: skip
_NUMBERS = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-9,
    60.0,
    1e9,
    -1e9,
    1e8,
    3.3,
    1e15,
    -1e39,
    1e39,
    5e-324,
    100.0,
    359.9,
]
_DATES = [
    "2026-01-01T00:00:00Z", "0001-01-01T00:00:00Z", "1960-02-29T23:59:59+14:00", "9999-12-31T23:59:59Z",
    "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00",
]  # fmt: skip
_BOX = {"left_px": 1.0, "top_px": 1e9, "width_px": 0.0, "height_px": -5.0, "label": "hot-spot"}
_LEADING = [
    "log_opened", "simulated", "planned", "mission_started", "position", "decided", "call", "photo", "notified",
]  # fmt: skip
_KINDS = {schema.kind_of(each) for each in schema.EVENTS}
_BEGINNINGS = {"log_opened", "mission_completed"}
_FIELDS = {
    schema.kind_of(each): [field for field in info.fields if field.name != "t"]
    for each, info in zip(schema.EVENTS, inspect.multi_type_info(schema.EVENTS), strict=True)
    if isinstance(info, inspect.StructType)
}


def hostile_log(seed: int, *, events: int = 120) -> bytes:
    """A log of so many events; the same seed gives the same log."""
    drawn = random.Random(seed)
    kinds = sorted(_KINDS - _BEGINNINGS)  # of which the last would hide all before it
    lines, t = list[bytes](), 0.0
    while len(lines) < events:
        kind = _LEADING[len(lines)] if len(lines) < len(_LEADING) else drawn.choice([*_LEADING[4:], *kinds])
        written = _line(kind, t, drawn)
        if written is not None:
            lines.append(written)
            steps = (0.0, 0.1, 1.0, 10.0)
            t = t + drawn.choice(steps) if drawn.random() < 0.97 else drawn.choice((0.0, -5.0, 7.0, 9e8))
    return b"".join(lines)


def _line(kind: str, t: float, drawn: random.Random) -> bytes | None:
    """A line with an event of that kind, None if the values that were drawn are none of its values."""
    facts = {
        "event": kind,
        "t": t,
        **{field.encode_name: _of(field.type, drawn) for field in _fields(kind, drawn)},
    }
    if kind == "notified" and drawn.random() < 0.5:
        facts["message"] = [{**_BOX, "label": drawn.choice(NAMES), "score": drawn.choice(_NUMBERS)}]
    line = json.dumps(facts).encode()
    try:
        decode(line)
    except (ValueError, RecursionError):
        return None
    return line + b"\n"


def _fields(kind: str, drawn: random.Random) -> Sequence[inspect.Field]:
    wanted = [field for field in _FIELDS[kind] if field.required or drawn.random() < 0.6]
    return [field for field in wanted if field.name != "version"]  # of which a later one is refused


def _of(hint: Any, drawn: random.Random, depth: int = 0) -> Any:
    """A value of the type that may break a reader; in rare cases one that the type does not allow."""
    match hint:
        case inspect.UnionType(types=types):
            return _of(drawn.choice(types), drawn, depth)
        case inspect.ListType(item_type=item) | inspect.CollectionType(item_type=item):
            return [_of(item, drawn, depth + 1) for _ in range(drawn.choice((0, 1, 2, 3 if depth else 20)))]
        case inspect.TupleType(item_types=items):
            return [_of(item, drawn, depth + 1) for item in items]
        case inspect.DictType(value_type=value):
            names = drawn.sample(NAMES, drawn.choice((0, 1, 3, 8)))
            return {name: _of(value, drawn, depth + 1) for name in names}
        case inspect.StructType(fields=fields) | inspect.DataclassType(fields=fields):
            wanted = [field for field in fields if field.required or drawn.random() < 0.5]
            return {field.encode_name: _of(field.type, drawn, depth + 1) for field in wanted}
    return _leaf(hint, drawn)


def _leaf(hint: Any, drawn: random.Random) -> Any:
    match hint:
        case inspect.LiteralType(values=values):
            return drawn.choice(values)
        case inspect.EnumType(cls=enum):
            return drawn.choice(list(enum)).value
        case inspect.BoolType():
            return drawn.random() < 0.5
        case inspect.NoneType():
            return None
        case inspect.IntType():
            return drawn.choice((0, 0, 1, 2, 3, 7, 100_000, 10**12, 2**53 + 1))
        case inspect.FloatType(ge=least, le=most):
            bounds = (-1e308 if least is None else least), (1e308 if most is None else most)
            return drawn.choice([each for each in _NUMBERS if bounds[0] <= each <= bounds[1]])
        case inspect.StrType(max_length=longest):
            return drawn.choice(NAMES)[:longest]
        case inspect.DateTimeType():
            return drawn.choice(_DATES)
    raise NotImplementedError(hint)
