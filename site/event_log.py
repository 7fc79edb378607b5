"""Writes docs/event-log.md from the events' own types: `python site/event_log.py`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec

from upwash.eventlog import schema
from upwash.eventlog.log import LONGEST_LINE_BYTES, MOST_EVENTS
from upwash.eventlog.schema import LONGEST, LONGEST_TEXT, MOST_FEW, MOST_ITEMS, Event, ServerStep

PAGE = Path(__file__).parents[1] / "docs" / "event-log.md"
_HEADING = re.compile(r"# --- (.+?) -+")
_CLASS = re.compile(r"class (\w+)\(")
_INTRODUCTION = f"""# The event log

`upwash fly --log FILE`, or `runs/TIME/events.jsonl`, and `upwash simulate --log FILE`: what happened, one JSON
object a line. Each has its name (`event`) and its time (`t`, in seconds since the log was opened). A field's
name ends in its unit; positions are `east_m`, `north_m` and `altitude_m` from the mission's home. A field with
a question mark is absent where there is nothing to say.

The first event tells the version of this table, which is {schema.VERSION}. `version` goes up with each change
that an earlier upwash could not read; programs should pass over fields that they do not know. A log of a later
version is refused. Logs of releases that wrote no version are read as far as their events are still known.

A log is data: no command opens a file or runs a program because a log names it. Every value is bounded: a time or
a length to {LONGEST:.0e} s or m either way, a text to {LONGEST_TEXT} characters, a list of waypoints or places to
{MOST_ITEMS} entries, any other list to {MOST_FEW}, a line to {LONGEST_LINE_BYTES >> 20} MiB, and a log to
{MOST_EVENTS} events. What a mission says (`message`) is nested at most 3 deep. An event that exceeds these bounds is
shortened as it is written, and `shortened` follows it. A reader leaves out a line that is no event of this table, and
tells the number of those lines, the first of them and the reason.

`check` numbers what the drone has to do with a server from its selection, or the start of a probe, to its end.
So a `call` names the check that made its server usable, and the `selected` of that number says why the server
was chosen; `joined`, `started`, `remote_failed` and every other step of that visit have the same number.

<!-- written by site/event_log.py from src/upwash/eventlog/schema.py: change that, then run `make docs` -->
"""


def page() -> str:
    """The page as it should be."""
    return _INTRODUCTION + "".join(_tables())


def _tables() -> Iterator[str]:
    for line in inspect.getsource(schema).splitlines():
        if heading := _HEADING.match(line):
            yield f"\n## {heading[1].capitalize()}\n\n| event | with | what it says |\n|---|---|---|\n"
        elif (found := _CLASS.match(line)) and (kind := getattr(schema, found[1])) in (
            ServerStep,
            *schema.EVENTS,
        ):
            yield f"| {' | '.join(_row(kind))} |\n"


def _row(kind: type[Event]) -> tuple[str, str, str]:
    said = " ".join(inspect.cleandoc(kind.__doc__ or "").split())
    if kind is ServerStep:
        return "each step of a server", _fields(kind), said
    return (
        f"`{schema.kind_of(kind)}`",
        "as each step" if issubclass(kind, ServerStep) else _fields(kind),
        said,
    )


def _fields(kind: type[Event]) -> str:
    may_be_absent = kind.__struct_config__.omit_defaults
    return ", ".join(
        f"`{field.name}`{'?' if may_be_absent and not field.required else ''}"
        for field in msgspec.structs.fields(kind)
        if field.name != "t"
    )


if __name__ == "__main__":
    PAGE.write_text(page())
