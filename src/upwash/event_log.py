"""The event log as it is read: JSON lines, one object an event.

A line that was torn as it was written, by a full disk or by a computer that lost its power, costs itself and no more.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from upwash.errors import UsageError

LONGEST_LINE_BYTES = 2**24
_BEGINNING = b'{"t":'  # of every line that is written
_log = logging.getLogger("upwash.event_log")


def read(path: Path) -> list[dict[str, Any]]:
    """The events of a log, flown or simulated, without torn lines, which are warned of; raises UsageError.

    A last line that was left unfinished is none yet.
    """
    return list(stream(path))


def stream(path: Path) -> Iterator[dict[str, Any]]:
    """The same one after the other, of which it holds no more than one; raises UsageError where it comes to it."""
    empty = True
    try:
        for number, line in enumerate(_lines(path), start=1):
            event = decode_line(line, path, number)
            if event is not None:
                yield event
                empty = False
    except OSError as error:
        raise UsageError(f"cannot read the event log {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not an event log: {error}") from error
    if empty:
        raise UsageError(f"{path} is not an event log: it is empty")


def _lines(path: Path) -> Iterator[bytes]:
    """The whole lines of a log; raises ValueError for one that no event is as long as."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError("it is a device or a pipe, and has to be read more than once: name a file")
    with path.open("rb") as file:
        while line := file.readline(LONGEST_LINE_BYTES + 1):
            if len(line) > LONGEST_LINE_BYTES:
                raise ValueError("it has a line of more than 16 MiB")
            if not line.endswith(b"\n"):  # what follows the last line's end is torn
                return
            yield line[:-1]


def decode_line(line: bytes, path: Path, number: int) -> dict[str, Any] | None:
    """The event of the line of that number; else as `decode` raises.

    Of a torn line, which is warned of, it is the event that was written behind the torn one, or None.
    """
    try:
        return decode(line)
    except (ValueError, RecursionError):
        if not _is_torn(line):
            raise
    _log.warning("%s: line %d is torn, and what it lost is left out", path, number)
    try:
        return decode(line[max(0, line.rfind(_BEGINNING)) :])
    except (ValueError, RecursionError):
        return None


def decode(line: bytes) -> dict[str, Any]:
    """The event of one line; raises ValueError or RecursionError where it is none."""
    entry = msgspec.json.decode(line, type=dict[str, Any])  # its errors are ValueErrors
    if not _is_event(entry):
        raise ValueError("each line of one has an event and its time")
    return entry


def _is_torn(line: bytes) -> bool:
    """Whether it begins as events do and then is no JSON, or has bytes that a disk never got."""
    if b"\0" in line:
        return True
    if not line.startswith(_BEGINNING):
        return _BEGINNING.startswith(line)
    try:
        msgspec.json.decode(line, type=msgspec.Raw)
    except msgspec.DecodeError:
        return True
    return False


def _is_event(entry: dict[str, Any]) -> bool:
    return isinstance(entry.get("event"), str) and isinstance(entry.get("t"), (int, float))
