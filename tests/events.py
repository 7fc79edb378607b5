"""Events of logs for tests: made from the facts that a test is about, and read as other programs read them."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from upwash.eventlog import schema
from upwash.eventlog.schema import Event

_NEW_YEAR = datetime(2026, 1, 1, tzinfo=UTC).isoformat()
_BLANKS: tuple[object, ...] = (
    None,
    0,
    "",
    False,
    [],
    {},
    _NEW_YEAR,
    "AVL",
    "local",
    "return",
    "program",
    "rates",
    "files",
)
_KINDS = {schema.kind_of(each): each for each in schema.EVENTS}


def event(kind: str, t: float | None = None, **facts: object) -> Event:
    """The event of that name with these facts, and with blanks for its others; unstamped where it has no time."""
    time = {} if t is None else {"t": t}
    return schema.DECODER.decode(
        msgspec.json.encode({"event": kind, **time, **_blanks(_KINDS[kind]), **facts})
    )


def line(kind: str, t: float, **facts: object) -> bytes:
    """The same as a line of a log."""
    return msgspec.json.encode(event(kind, t, **facts)) + b"\n"


def written(events: Iterable[Event]) -> list[dict[str, Any]]:
    """The events as the log has them."""
    return [msgspec.json.decode(msgspec.json.encode(each)) for each in events]


def read(log: Path | str, *kinds: str) -> list[dict[str, Any]]:
    """The events of these kinds, or all, in the whole lines of a log that may still grow, or is not there yet."""
    lines = Path(log).read_bytes().splitlines(keepends=True) if Path(log).exists() else []
    events = [msgspec.json.decode(each) for each in lines if each.endswith(b"\n")]
    return [each for each in events if not kinds or each["event"] in kinds]


@functools.cache
def _blanks(kind: type[msgspec.Struct]) -> dict[str, object]:
    return {field.name: _blank(field.type) for field in msgspec.structs.fields(kind) if field.required}


def _blank(hint: object) -> object:
    for blank in _BLANKS:
        try:
            msgspec.convert(blank, hint, strict=True)
        except msgspec.ValidationError:
            continue
        return blank
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return _blanks(hint)
    return {"east_m": 0.0, "north_m": 0.0}
