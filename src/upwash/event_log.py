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
        events = [decode(line) for line in lines]
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not an event log: {error}") from error
    if not events:
        raise UsageError(f"{path} is not an event log: it is empty")
    return events


def decode(line: bytes) -> dict[str, Any]:
    """The event of one line; raises ValueError or RecursionError where it is none."""
    entry = msgspec.json.decode(line, type=dict[str, Any])  # its errors are ValueErrors
    if not _is_event(entry):
        raise ValueError("each line of one has an event and its time")
    return entry


def _is_event(entry: dict[str, Any]) -> bool:
    return isinstance(entry.get("event"), str) and isinstance(entry.get("t"), (int, float))
