"""The event log as it is read: JSON lines, one object an event.

A line that was torn as it was written, by a full disk or by a computer that lost its power, costs itself and no more.
A log of a later version is refused. In one of an earlier release, which says no version, events that are not known
any more are passed over.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event

LONGEST_LINE_BYTES = 2**24
_VERSIONED = frozenset({schema.LogOpened, schema.LogResumed, schema.Simulated})
_BEGINNINGS = (b'{"event":', b'{"t":')  # of every line that is written, and of those of earlier releases
_log = logging.getLogger("upwash.event_log")


def read(file: str | os.PathLike[str]) -> list[Event]:
    """The events of a log, flown or simulated, without torn lines, which are warned of; raises UsageError.

    `t` counts seconds from the start of the program, and docs/event-log.md has the fields of each kind. A last line
    that was left unfinished is no event yet.
    """
    return list(stream(Path(file)))


def stream(path: Path) -> Iterator[Event]:
    """The same one after the other, of which it holds no more than one; raises UsageError where it comes to it."""
    empty, lines = True, LineReader(path)
    try:
        for line in _lines(path):
            event = lines.take(line)
            if event is not None:
                yield event
                empty = False
    except OSError as error:
        raise UsageError(f"cannot read the event log {path}: {error.strerror}") from error
    except ValueError as error:
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


class LineReader:
    """Makes events of the lines of one log, one line after the other."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._number = 0
        self._version = 0  # that the log has said last

    def take_all(self, lines: bytes) -> Iterable[Event]:
        """The events of the next lines, each with its end; raises UsageError where it comes to what is none."""
        events = _decode_all(lines)
        if events is None:
            return self._one_by_one(lines)
        self._number += len(events)
        return events

    def _one_by_one(self, lines: bytes) -> Iterator[Event]:
        for line in lines.split(b"\n")[:-1]:
            if (event := self.take(line)) is not None:
                yield event

    def take(self, line: bytes) -> Event | None:
        """The event of the next line; raises UsageError where it is none, or none that can be read.

        Of a torn line, which is warned of, it is the event that was written behind the torn one, or None.
        """
        self._number += 1
        try:
            event = decode(line)
        except (ValueError, RecursionError) as error:
            return self._without_event(line, error)
        if isinstance(event, (schema.LogOpened, schema.LogResumed, schema.Simulated)):
            self._require_readable(event.version)
            self._version = event.version
        return event

    def _without_event(self, line: bytes, error: Exception) -> Event | None:
        if _is_torn(line):
            _log.warning("%s: line %d is torn, and what it lost is left out", self._path, self._number)
            try:
                return decode(line[_last_beginning(line) :])
            except (ValueError, RecursionError):
                return None
        try:
            header = msgspec.json.decode(line, type=_Header)
        except (ValueError, RecursionError):
            raise UsageError(
                f"{self._path} is not an event log: line {self._number}: each line of one has an event and its time"
            ) from error
        self._require_readable(header.version)
        if self._version == 0 and header.event not in _KINDS:
            return None
        raise UsageError(
            f"{self._path} is not an event log that this version reads: line {self._number}: {error}"
        ) from error

    def _require_readable(self, version: int) -> None:
        if version > schema.VERSION:
            raise UsageError(
                f"{self._path}: line {self._number}: this log is of version {version}, and this upwash reads up to "
                f"{schema.VERSION}: read it with the upwash that wrote it, or a later one"
            )


class _Header(msgspec.Struct):
    """What each line of each version has."""

    event: str
    t: float
    version: int = 0


_KINDS = frozenset(map(schema.kind_of, schema.EVENTS))


def decode(line: bytes) -> Event:
    """The event of one line; raises ValueError or RecursionError where it is none."""
    event = schema.DECODER.decode(line)  # its errors are ValueErrors
    if not event.is_stamped:
        raise ValueError("each line of one has an event and its time")
    return event


def _decode_all(lines: bytes) -> list[Event] | None:
    """The events of lines that are read at once, in half the time; None where a line is to be looked at by itself."""
    try:
        events = schema.DECODER.decode_lines(lines)
    except (ValueError, RecursionError):
        return None
    plain = len(events) == lines.count(b"\n") and _VERSIONED.isdisjoint(map(type, events))
    return events if plain and all(event.is_stamped for event in events) else None


def _last_beginning(line: bytes) -> int:
    return max(0, *(line.rfind(each) for each in _BEGINNINGS))


def _is_torn(line: bytes) -> bool:
    """Whether it begins as events do and then is no JSON, or has bytes that a disk never got."""
    if b"\0" in line:
        return True
    if not line.startswith(_BEGINNINGS):
        return any(each.startswith(line) for each in _BEGINNINGS)
    try:
        msgspec.json.decode(line, type=msgspec.Raw)
    except msgspec.DecodeError:
        return True
    return False
