"""The event log as it is read: JSON lines, one object an event.

A log may come from a stranger, and a full disk or a power cut may have torn its lines. A reader leaves out a line
that is too long or no event of this version, and reports it. A reader refuses a log of a later version. A log of an
early release names no version: a reader skips its unknown events.
"""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.results import CallResult, read_result
from upwash.eventlog.schema import Event
from upwash.support.loading import extra
from upwash.support.text import printable

LONGEST_LINE_BYTES = 2**24
MOST_EVENTS = 2_000_000  # 23 days of positions: the calls among them fit into memory
_PIECE_BYTES = 2**16
_LINES_BEFORE_AN_EVENT = 1000  # a file that begins with more is no log
_LONGEST_WHY = 200  # characters
_VERSIONED = frozenset({schema.LogOpened, schema.LogResumed, schema.Simulated})
_BEGINNINGS = (b'{"event":', b'{"t":')  # of every line that is written, and of those of earlier releases
_log = logging.getLogger("upwash.event_log")


def read(file: str | os.PathLike[str]) -> Events:
    """The events of a log, flown or simulated; a warning tells the lines that are left out. Raises UsageError.

    `t` counts seconds from the start of the program, and docs/event-log.md has the fields of each kind. A last line
    that was left unfinished is no event yet.
    """
    return Events(EventLog(Path(file)))


class Events(list[Event]):
    """The events of a log, in their order."""

    def to_pandas(self, kind: str = "") -> Any:
        """A pandas.DataFrame: a row for each call, or for each event of that kind, such as "decided".

        Columns are the fields of `CallResult`, or of the event; those of a position are columns of their own, such as
        `position.east_m`. `attrs` has the log's origin. UsageError for a kind that no event has, and without pandas.
        """
        with extra("pandas"):
            import pandas
        if kind and kind not in _KINDS:
            raise UsageError(
                f"{printable(kind, _LONGEST_WHY)!r} is no kind of event: docs/event-log.md lists them"
            )
        columns = (
            next(event.__struct_fields__ for event in schema.EVENTS if schema.kind_of(event) == kind)
            if kind
            else tuple(field.name for field in fields(CallResult))
        )
        rows = [event for event in self if event.kind == kind] if kind else read_result(self).calls
        table = [{name: msgspec.to_builtins(getattr(row, name)) for name in columns} for row in rows]
        frame = pandas.json_normalize(table) if table else pandas.DataFrame(columns=columns)
        opening = self[0] if self else None
        if isinstance(opening, (schema.LogOpened, schema.Simulated)):
            frame.attrs = {name: getattr(opening, name, "") for name in ("upwash", "commit", "configuration")}
        return frame


class EventLog(Iterable[Event]):
    """The events of a log, one after the other; each pass reads the file anew and holds one event.

    After a full pass `left_out` names the lines that are no events, and why; empty if there are none.
    """

    def __init__(self, path: Path) -> None:
        self.left_out = ""
        self._path = path

    def __iter__(self) -> Iterator[Event]:
        lines = LineReader(self._path)
        try:
            with opened(self._path) as file:
                while content := file.read(_PIECE_BYTES):
                    yield from lines.take_all(content)
        except OSError as error:
            raise UsageError(f"cannot read the event log {self._path}: {error.strerror}") from error
        lines.require_events()
        if lines.left_out and not self.left_out:
            _log.warning("%s: %s", self._path, lines.left_out)
        self.left_out = lines.left_out


def may_begin_a_log(content: bytes) -> bool:
    """Whether a file that begins so may be a log, perhaps a torn one."""
    return any(content.startswith(each) or each.startswith(content) for each in _BEGINNINGS)


def opened(path: Path) -> BinaryIO:
    """The file of a log, to be read from its beginning; raises OSError, or UsageError where it is no file."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        mode = os.fstat(descriptor).st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UsageError(
                f"{path} is not an event log: it is a device or a pipe, and has to be read more than once: "
                "name a file"
            )
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


class LineReader:
    """Makes events of the content of one log, piece by piece, and counts the lines that are left out."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rest = bytearray()  # an unfinished line
        self._is_too_long = False  # the unfinished line; its begin is discarded
        self._number = 0  # of the last line
        self._events = 0
        self._version = 0  # the last that the log named
        self._left_out = 0
        self._first_left_out = ""

    @property
    def left_out(self) -> str:
        """The number of lines that are no events, and why the first is none; empty if there are none."""
        if not self._left_out:
            return ""
        if self._left_out == 1:
            return f"1 line of the log is left out, {self._first_left_out}"
        return f"{self._left_out} lines of the log are left out, the first is {self._first_left_out}"

    def require_events(self) -> None:
        """Raise UsageError if the log has no event."""
        if not self._events:
            why = self._first_left_out or "it is empty"
            raise UsageError(f"{self._path} is not an event log: {why}")

    def take_all(self, content: bytes) -> Iterable[Event]:
        """The events of the complete lines; an unfinished last line waits for the next content.

        Raises UsageError, when its line is reached, for a later version or a file that is no log.
        """
        lines, end, rest = content.rpartition(b"\n")
        if end:
            lines, self._rest = bytes(self._rest) + lines + end, bytearray()
            if self._is_too_long:
                self._is_too_long = False
                self._leave_out(f"it has more than {LONGEST_LINE_BYTES // 2**20} MiB")
                lines = lines.partition(b"\n")[2]
        self._rest += rest
        if len(self._rest) > LONGEST_LINE_BYTES or self._is_too_long:
            self._is_too_long = True
            self._rest.clear()
        return self._events_of(lines) if end and lines else ()

    def _events_of(self, lines: bytes) -> Iterable[Event]:
        count = lines.count(b"\n")
        if self._events + count > MOST_EVENTS:
            self._leave_out(f"no more than {MOST_EVENTS} events of a log are read", count)
            return ()
        events = _decode_all(lines, count)
        if events is None:
            return self._one_by_one(lines)
        self._number += count
        self._events += count
        return events

    def _one_by_one(self, lines: bytes) -> Iterator[Event]:
        for line in lines.split(b"\n")[:-1]:
            if (event := self._take(line)) is not None:
                self._events += 1
                yield event

    def _take(self, line: bytes) -> Event | None:
        """The event of the next line; of a torn line the event at its end; None without one."""
        try:
            event = decode(line)
        except (ValueError, RecursionError) as error:
            return self._without_event(line, error)
        self._number += 1
        if isinstance(event, (schema.LogOpened, schema.LogResumed, schema.Simulated)):
            self._require_readable(event.version)
            self._version = event.version
        return event

    def _without_event(self, line: bytes, error: Exception) -> Event | None:
        if _is_torn(line):
            self._leave_out("it is torn")
            try:
                return decode(line[max(0, *(line.rfind(beginning) for beginning in _BEGINNINGS)) :])
            except (ValueError, RecursionError):
                return None
        try:
            header = msgspec.json.decode(line, type=_Header)
        except (ValueError, RecursionError):
            self._leave_out(_NO_EVENT)
            return None
        if self._version == 0 and header.event not in _KINDS:
            self._number += 1
        else:
            self._leave_out(printable(str(error), _LONGEST_WHY))
        self._require_readable(header.version)
        return None

    def _leave_out(self, why: str, lines: int = 1) -> None:
        if not self._left_out:
            self._first_left_out = f"line {self._number + 1}: {why}"
        self._number += lines
        self._left_out += lines
        if self._left_out > _LINES_BEFORE_AN_EVENT:
            self.require_events()

    def _require_readable(self, version: int) -> None:
        if version > schema.VERSION:
            raise UsageError(
                f"{self._path}: line {self._number}: this log is of version {version}, and this upwash reads up to "
                f"{schema.VERSION}: read it with the upwash that wrote it, or a later one"
            )


class _Header(msgspec.Struct):
    """The fields of a line in every version."""

    event: str
    t: float
    version: int = 0


_KINDS = frozenset(map(schema.kind_of, schema.EVENTS))
_NO_EVENT = "each line of one has an event and its time"


def decode(line: bytes) -> Event:
    """The event of one line; raises ValueError or RecursionError for any other content."""
    event = schema.DECODER.decode(line)  # its errors are ValueErrors
    if not event.is_stamped:
        raise ValueError(_NO_EVENT)
    return event


def _decode_all(lines: bytes, count: int) -> list[Event] | None:
    """The events of lines read at once, in half the time; None if the lines must be read one by one."""
    try:
        events = schema.DECODER.decode_lines(lines)
    except (ValueError, RecursionError):
        return None
    plain = len(events) == count and _VERSIONED.isdisjoint(map(type, events))
    return events if plain and all(event.is_stamped for event in events) else None


def _is_torn(line: bytes) -> bool:
    """Whether a line begins like an event and is no JSON, or has the zero bytes of a lost disk write."""
    if b"\0" in line:
        return True
    if not line.startswith(_BEGINNINGS):
        return any(beginning.startswith(line) for beginning in _BEGINNINGS)
    try:
        msgspec.json.decode(line, type=msgspec.Raw)
    except msgspec.DecodeError:
        return True
    except RecursionError:  # JSON as far as it was read
        return False
    return False
