"""The event log as a file of JSON lines, the truth about a run."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec

from upwash import event_log
from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.real.log_file import LogFile, Unwritten
from upwash.text import json_line

_TRY_AGAIN_S = 1.0  # to write to a full disk
_log = logging.getLogger("upwash.journal")
Watcher = Callable[[Mapping[str, Any]], None]


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
        self._began_s = self._loop.time() - opened_s
        event = "log_resumed" if resumes else "log_opened"
        opening = {"t": round(opened_s, 6), "event": event, "time": now.isoformat()}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = LogFile(path)
            try:
                if resumes:
                    self._file.cut_torn_line()
                self._file.append(_encoded(opening))
            except OSError:
                self._file.close()
                raise
        except OSError as error:
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error
        self._show(opening)

    def record(self, event: str, **facts: object) -> None:
        """Adds one event with its facts; it is in the file when this returns, if that has room.

        A disk that fills up in flight is no reason to end it: what is missing is written as soon as there is room.
        """
        entry = {"t": self._now_s(), "event": event, **facts}
        try:
            self._keep(_encoded(entry))
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
                self._file.append(
                    _encoded({"t": self._now_s(), "event": "events_lost", "count": self._unwritten.lost})
                )
                self._unwritten.lost = 0
        except OSError as error:
            self._missed(error)
        else:
            self._unwritten.why = ""
            _log.warning("the event log %s has room again: what was missing is written", self.path)

    def _missed(self, error: OSError) -> None:
        self._unwritten.why = error.strerror or str(error)
        self._next_try_s = self._loop.time() + _TRY_AGAIN_S

    def _show(self, entry: Mapping[str, Any]) -> None:
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


def _encoded(entry: Mapping[str, Any]) -> bytes:
    try:
        line = msgspec.json.encode(entry)
    except UnicodeEncodeError:  # a file name, say, that is no text
        line = msgspec.json.encode({name: _printable(fact) for name, fact in entry.items()})
    return json_line(line)


class _Opening(msgspec.Struct):
    time: Annotated[datetime, msgspec.Meta(tz=True)]


class _ClockSet(msgspec.Struct):
    t: float
    after: Annotated[datetime, msgspec.Meta(tz=True)]


def read_events(path: Path) -> list[dict[str, Any]]:
    """The events of a flight's log, which begins with the time of day; raises UsageError."""
    events = event_log.read(path)
    if events[0]["event"] != "log_opened":
        raise UsageError(f"{path} is not the event log of a flight")
    try:
        for name, kind in (("log_opened", _Opening), ("clock_set", _ClockSet)):
            msgspec.convert([event for event in events if event["event"] == name], list[kind])  # type: ignore[valid-type]
    except msgspec.ValidationError as error:
        raise UsageError(f"{path} is not an event log: {error}") from error
    return events


def _seconds_since(events: Sequence[Mapping[str, Any]], now: datetime) -> float:
    """The time now of the last run in the log: by the time of day, unless that has gone back since."""
    known_s, known = next(
        (event["t"], event["after"]) if event["event"] == "clock_set" else (0.0, event["time"])
        for event in reversed(events)
        if event["event"] in ("log_opened", "clock_set")
    )
    last_s: float = events[-1]["t"]
    return max(last_s, known_s + (now - datetime.fromisoformat(known)).total_seconds())


def _printable(fact: object) -> object:
    return fact if isinstance(fact, (int, float)) else str(fact).encode(errors="backslashreplace").decode()


class JournalNotifier:
    """Tells the user through the event log, and so through whatever shows it."""

    def __init__(self, journal: FileJournal) -> None:
        self._journal = journal

    async def notify(self, message: object, at: Position) -> None:
        """Records the message with its place."""
        self._journal.record("notified", message=msgspec.to_builtins(message), at=msgspec.to_builtins(at))
