"""The event log as a file of JSON lines; every line is whole, even if the disk fills up."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
import stat
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.fitting import fitted, line_of
from upwash.eventlog.schema import LONGEST, Event
from upwash.support.output_files import append_whole
from upwash.support.software import software

_MOST_UNWRITTEN_BYTES = 2**25  # in memory: some hours of a flight
_LOOK_BYTES = 100
_TRY_AGAIN_S = 1.0  # to write to a full disk
_log = logging.getLogger("upwash.journal")
Watcher = Callable[[Event], None]


class Unwritten:
    """The lines for which a file has had no room, in their order, and `why`; "" if it lacks none.

    Lines that do not fit into memory either are only counted, as `lost`.
    """

    def __init__(self) -> None:
        self.lines: deque[bytes] = deque()
        self.lost = 0
        self.why = ""
        self._size_bytes = 0

    def add(self, line: bytes) -> None:
        """Keep another line in memory until the file has room."""
        if self.lost or self._size_bytes + len(line) > _MOST_UNWRITTEN_BYTES:
            self.lost += 1
            return
        self._size_bytes += len(line)
        self.lines.append(line)

    def written(self) -> None:
        """Drop the first line, which is in the file now."""
        self._size_bytes -= len(self.lines.popleft())

    def __len__(self) -> int:
        """How many lines the file lacks."""
        return len(self.lines) + self.lost


class FileJournal:
    """Appends each event as one line in one write, so that a crash leaves no torn line behind.

    `t` counts seconds of the event loop's clock from the first event, which also has the time of day. With `resumes`
    the log of an earlier process is continued, its time too. One process at a time writes to a log. Lines for which
    the disk has no room wait in `unwritten`, in their order.
    """

    def __init__(
        self,
        path: Path,
        *,
        watchers: tuple[Watcher, ...] = (),
        resumes: bool = False,
        unwritten: Unwritten | None = None,
    ) -> None:
        self.path = path
        self._watchers = watchers
        self._loop = asyncio.get_running_loop()
        self._unwritten = Unwritten() if unwritten is None else unwritten
        self._next_try_s = 0.0
        now = datetime.now(UTC)
        opened_s = _seconds_since(read_events(path), now) if resumes else 0.0
        if opened_s > LONGEST / 2:
            raise UsageError(
                f"no flight is taken up after {opened_s:.0f} s: the times in {path} are not true"
            )
        self._began_s = self._loop.time() - opened_s
        opening: Event = (
            schema.LogResumed(t=round(opened_s, 6), time=now, version=schema.VERSION)
            if resumes
            else schema.LogOpened(
                t=0.0, time=now, version=schema.VERSION, upwash=software().version, commit=software().commit
            )
        )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _LineFile(path, cuts_torn_line=resumes)
            try:
                self._file.append(line_of(opening))
            except OSError:
                self._file.close()
                raise
        except OSError as error:
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error
        self._show(opening)

    def record(self, event: Event) -> None:
        """Adds one event; returns once the file has it, or has no room.

        A disk that fills up does not end the flight: missing events are written as soon as there is room.
        """
        for entry, line in fitted(msgspec.structs.replace(event, t=self._now_s())):
            try:
                self._keep(line)
            finally:
                self._show(entry)

    async def notify(self, message: object, at: Position, photo: int | None = None) -> None:
        """Notifies the user by an event in the log, which the views of the log show."""
        self.record(schema.Notified(message=msgspec.to_builtins(message), at=at, photo=photo))

    def close(self) -> None:
        """Closes the log, after the missing lines if there is room for them now."""
        if self._unwritten:
            self._catch_up()
        try:
            self._file.close()
        except OSError as error:
            self._unwritten.why = error.strerror or str(error)
            _log.error("the event log %s may lack its last events: %s", self.path, error)

    def _now_s(self) -> float:
        return round(self._loop.time() - self._began_s, 6)

    def _keep(self, line: bytes) -> None:
        if self._unwritten:
            self._unwritten.add(line)
            if self._loop.time() >= self._next_try_s:
                self._catch_up()
            return
        try:
            self._file.append(line)
        except OSError as error:
            self._unwritten.add(line)
            self._missed(error)
            _log.error(
                "the event log %s has no room (%s): the flight goes on; what is missing is written once there is",
                self.path,
                error.strerror,
            )

    def _catch_up(self) -> None:
        try:
            while self._unwritten.lines:
                self._file.append(self._unwritten.lines[0])
                self._unwritten.written()
            if self._unwritten.lost:
                self._file.append(line_of(schema.EventsLost(t=self._now_s(), count=self._unwritten.lost)))
                self._unwritten.lost = 0
        except OSError as error:
            self._missed(error)
        else:
            self._unwritten.why = ""
            _log.warning("the event log %s has room again: what was missing is written", self.path)

    def _missed(self, error: OSError) -> None:
        self._unwritten.why = error.strerror or str(error)
        self._next_try_s = self._loop.time() + _TRY_AGAIN_S

    def _show(self, entry: Event) -> None:
        """Pass an event to the watchers; a watcher that fails, as without its terminal, gets no more events."""
        for watch in self._watchers:
            try:
                watch(entry)
            except Exception as error:  # noqa: BLE001 - the flight goes on after any
                self._watchers = tuple(watcher for watcher in self._watchers if watcher is not watch)
                _log.error("what shows the flight has failed, and is told no more: %s", error)


class _LineFile:
    """A file to which only this process appends lines; raises OSError, or UsageError if another process does."""

    def __init__(self, path: Path, *, cuts_torn_line: bool) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            _lock(self._file, path)
            self._size_bytes = os.fstat(self._file).st_size
            if self._size_bytes and not event_log.may_begin_a_log(os.pread(self._file, _LOOK_BYTES, 0)):
                raise UsageError(f"{path} is no event log, and stays as it is: name another file for the log")
            whole_bytes = self._end_of_last_line()
            if cuts_torn_line:
                os.ftruncate(self._file, whole_bytes)
                self._size_bytes = whole_bytes
            self._is_torn = whole_bytes != self._size_bytes
        except BaseException:
            os.close(self._file)
            raise

    def append(self, line: bytes) -> None:
        """Adds one line, in one write; raises OSError if the line is not in the file afterwards.

        A line that was cut is taken back. If even that fails, the next append ends it first.
        """
        content = (b"\n" if self._is_torn else b"") + line + b"\n"
        try:
            append_whole(self._file, content)
        except OSError:
            size_bytes = os.fstat(self._file).st_size
            self._is_torn |= size_bytes != self._size_bytes
            self._size_bytes = size_bytes
            raise
        self._size_bytes += len(content)
        self._is_torn = False

    def close(self) -> None:
        """Closes the file; raises OSError if the system reports only now that data was lost."""
        os.close(self._file)

    def _end_of_last_line(self) -> int:
        """The length in bytes of the file's whole lines."""
        if not stat.S_ISREG(os.fstat(self._file).st_mode):
            return self._size_bytes
        end_bytes = self._size_bytes
        while end_bytes:
            piece_bytes = min(end_bytes, 65_536)
            found = os.pread(self._file, piece_bytes, end_bytes - piece_bytes).rfind(b"\n")
            if found >= 0:
                return end_bytes - piece_bytes + found + 1
            end_bytes -= piece_bytes
        return 0


def _lock(file: int, path: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(
            f"another program is writing the event log {path}: is the flight still under way?"
        ) from None


def read_events(path: Path) -> list[Event]:
    """The events of a flight's log, which begins with the time of day; raises UsageError."""
    events = event_log.read(path)
    if not isinstance(events[0], schema.LogOpened):
        raise UsageError(f"{path} is not the event log of a flight")
    return events


def _seconds_since(events: Sequence[Event], now: datetime) -> float:
    """The present time `t` of the last run in the log, from the time of day, and never before its last event."""
    last_s = events[-1].t
    for event in reversed(events):
        match event:
            case schema.ClockSet(t=known_s, after=known):
                return max(last_s, known_s + (now - known).total_seconds())
            case schema.LogOpened(time=known):
                return max(last_s, (now - known).total_seconds())
    return last_s
