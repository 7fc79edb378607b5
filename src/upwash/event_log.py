"""The event log as it is read: JSON lines, one object an event."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from upwash.errors import UsageError


def read(path: Path) -> list[dict[str, Any]]:
    """The events of a log, flown or simulated, but for a last line that was left unfinished; raises UsageError."""
    try:
        lines = path.read_bytes().split(b"\n")[:-1]  # what follows the last line's end is nothing, or torn
    except OSError as error:
        raise UsageError(f"cannot read the event log {path}: {error.strerror}") from error
    try:
        events = msgspec.convert([msgspec.json.decode(line) for line in lines], list[dict[str, Any]])
    except (ValueError, RecursionError) as error:  # msgspec's are ValueErrors, as is text that is not UTF-8
        raise UsageError(f"{path} is not an event log: {error}") from error
    if not events or not all(map(_is_event, events)):
        raise UsageError(f"{path} is not an event log: each line of one has an event and its time")
    return events


def _is_event(entry: dict[str, Any]) -> bool:
    return isinstance(entry.get("event"), str) and isinstance(entry.get("t"), (int, float))
