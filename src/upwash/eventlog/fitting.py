"""Shortens events that exceed the bounds of a log before they are written."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from upwash.eventlog import schema
from upwash.eventlog.log import LONGEST_LINE_BYTES, decode
from upwash.eventlog.schema import LONGEST, LONGEST_TEXT, MOST_FEW, Event
from upwash.support.text import counted, json_line, printable

_LONGEST_WHY = 200  # characters
_DEEPEST = {schema.Notified: 3, schema.PhotoTaken: 3}  # containers in containers, of foreign content
_FLAT = 10  # of all other events: deeper than any


def line_of(event: Event) -> bytes:
    """The event as a line of a log, without its line end; file names that are no Unicode are escaped."""
    try:
        line = msgspec.json.encode(event)
    except UnicodeEncodeError:
        facts = _part(msgspec.to_builtins(event), most=None, depth=_FLAT)
        line = msgspec.json.encode(msgspec.convert(facts, type(event)))
    return json_line(line)


def fitted(event: Event) -> Sequence[tuple[Event, bytes]]:
    """The event itself if readers accept it; else a shortened event, if possible, and a `shortened`; as lines too."""
    line, why = _line(event)
    if not why:
        return ((event, line),)
    notice = schema.Shortened(t=event.t, of=event.kind, why=why)
    for most in (LONGEST_TEXT, MOST_FEW, 30):
        facts = _part(msgspec.to_builtins(event), most=most, depth=_DEEPEST.get(type(event), _FLAT))
        try:
            part = msgspec.convert(facts, type(event))
        except msgspec.ValidationError:
            continue
        line, refused = _line(part)
        if not refused:
            return (part, line), (notice, line_of(notice))
    return ((notice, line_of(notice)),)


def _line(event: Event) -> tuple[bytes, str]:
    """The event as a line, and why readers would leave it out; "" if they accept it."""
    line = b""
    try:
        line = line_of(event)
        decode(line)
    except (ValueError, RecursionError) as error:
        return line, printable(str(error), _LONGEST_WHY)
    return line, "it is too long" if len(line) > LONGEST_LINE_BYTES else ""


def _part(fact: object, *, most: int | None, depth: int) -> object:
    """The first `most` entries of texts and lists, numbers within the bounds, and deeper containers as text."""
    match fact:
        case str():
            text = fact.encode(errors="backslashreplace").decode()
            return text if most is None or len(text) <= most else f"{text[: most - 1]}…"
        case float():
            return None if math.isnan(fact) else max(-LONGEST, min(LONGEST, fact))
        case list() | dict() if depth < 0:
            return counted(len(fact), "entry")
        case list():
            return [_part(entry, most=most, depth=depth - 1) for entry in fact[:most]]
        case dict():
            return {
                _part(key, most=most, depth=0): _part(value, most=most, depth=depth - 1)
                for key, value in list(fact.items())[:most]
            }
    return fact
