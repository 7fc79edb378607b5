"""The event log as a file of JSON lines, the truth about a run."""

from __future__ import annotations

import asyncio
import logging
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
from upwash.real.host.log_file import LogFile, Unwritten

_TRY_AGAIN_S = 1.0  # to write to a full disk
_log = logging.getLogger("upwash.journal")
Watcher = Callable[[Event], None]


class FileJournal:
    """Appends each event as one line in one write, so that a crash leaves no torn line behind.

    `t` counts seconds of the event loop's clock from the first event; that one also tells the time of day. With
    `resumes` a log that another process began is continued, its time too. One process at a time writes to a log.
    What the disk has no room for is held in `unwritten`, in its order, until there is room.
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
        kind = schema.LogResumed if resumes else schema.LogOpened
        opening = kind(t=round(opened_s, 6), time=now, version=schema.VERSION)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = LogFile(path)
            try:
                if resumes:
                    self._file.cut_torn_line()
                self._file.append(line_of(opening))
            except OSError:
                self._file.close()
                raise
        except OSError as error:
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error
        self._show(opening)

    def record(self, event: Event) -> None:
        """Adds one event; it is in the file when this returns, if that has room.

        A disk that fills up in flight is no reason to end it: what is missing is written as soon as there is room.
        """
        for entry in fitted(msgspec.structs.replace(event, t=self._now_s())):
            try:
                self._keep(line_of(entry))
            finally:
                self._show(entry)

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
        """Writes what the log lacks, as far as there is room."""
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
        """Has the watchers see an event; one that fails, as where its terminal is gone, sees no more of them."""
        for watch in self._watchers:
            try:
                watch(entry)
            except Exception as error:  # noqa: BLE001 - whatever it is, the flight goes on
                self._watchers = tuple(each for each in self._watchers if each is not watch)
                _log.error("what shows the flight has failed, and is told no more: %s", error)

    def close(self) -> None:
        """Ends the log, with what it lacks if there is room for it now."""
        if self._unwritten:
            self._catch_up()
        try:
            self._file.close()
        except OSError as error:
            self._unwritten.why = error.strerror or str(error)
            _log.error("the event log %s may lack its last events: %s", self.path, error)


def read_events(path: Path) -> list[Event]:
    """The events of a flight's log, which begins with the time of day; raises UsageError."""
    events = event_log.read(path)
    if not isinstance(events[0], schema.LogOpened):
        raise UsageError(f"{path} is not the event log of a flight")
    return events


def _seconds_since(events: Sequence[Event], now: datetime) -> float:
    """The time now of the last run in the log: by the time of day, unless that has gone back since."""
    last_s = events[-1].t
    for event in reversed(events):
        match event:
            case schema.ClockSet(t=known_s, after=known):
                return max(last_s, known_s + (now - known).total_seconds())
            case schema.LogOpened(time=known):
                return max(last_s, (now - known).total_seconds())
    return last_s


class JournalNotifier:
    """Tells the user through the event log, and so through whatever shows it."""

    def __init__(self, journal: FileJournal) -> None:
        self._journal = journal

    async def notify(self, message: object, at: Position) -> None:
        """Records the message with its place."""
        self._journal.record(schema.Notified(message=msgspec.to_builtins(message), at=at))
