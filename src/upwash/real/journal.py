"""The event log as a file of JSON lines, the truth about a run."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec

from upwash import event_log
from upwash.core.geo import Position
from upwash.errors import UsageError

_log = logging.getLogger("upwash.journal")
Watcher = Callable[[Mapping[str, Any]], None]


class FileJournal:
    """Appends each event as one line in one write, so that a crash leaves no torn line behind.

    `t` counts seconds of the event loop's clock from the first event; that one also tells the time of day. With
    `resumes` a log that another process began is continued, its time too. One process at a time writes to a log.
    """

    def __init__(self, path: Path, *, watchers: tuple[Watcher, ...] = (), resumes: bool = False) -> None:
        self.path = path
        self._watchers = watchers
        self._loop = asyncio.get_running_loop()
        self._failed = False
        now = datetime.now(UTC)
        opened_s = _seconds_since(read_events(path), now) if resumes else 0.0
        self._began_s = self._loop.time() - opened_s
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error
        try:
            self._lock()
            if resumes:
                _cut_torn_line(path)
            event = "log_resumed" if resumes else "log_opened"
            self._append({"t": round(opened_s, 6), "event": event, "time": now.isoformat()})
        except OSError as error:
            os.close(self._file)
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error

    def record(self, event: str, **facts: object) -> None:
        """Adds one event with its facts; it is in the file when this returns.

        A disk that fills up in flight is no reason to end it: the log then has gaps, which is logged once.
        """
        try:
            self._append({"t": round(self._loop.time() - self._began_s, 6), "event": event, **facts})
        except OSError as error:
            if not self._failed:
                _log.error("the event log %s is incomplete from now on: %s", self.path, error)
            self._failed = True

    def _append(self, entry: Mapping[str, Any]) -> None:
        try:
            self._write(entry)
        finally:
            for watch in self._watchers:
                self._show(watch, entry)

    def _show(self, watch: Watcher, entry: Mapping[str, Any]) -> None:
        """Has a watcher see an event; one that fails, as where its terminal is gone, sees no more of them."""
        try:
            watch(entry)
        except Exception as error:  # noqa: BLE001 - whatever it is, the flight goes on
            self._watchers = tuple(each for each in self._watchers if each is not watch)
            _log.error("what shows the flight has failed, and is told no more: %s", error)

    def _write(self, entry: Mapping[str, Any]) -> None:
        try:
            line = msgspec.json.encode(entry)
        except UnicodeEncodeError:  # a file name, say, that is no text
            line = msgspec.json.encode({name: _printable(fact) for name, fact in entry.items()})
        os.write(self._file, line + b"\n")

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise UsageError(
                f"another program is writing the event log {self.path}: is the flight still under way?"
            ) from None

    def close(self) -> None:
        """Ends the log."""
        os.close(self._file)


class _Opening(msgspec.Struct):
    time: Annotated[datetime, msgspec.Meta(tz=True)]


def read_events(path: Path) -> list[dict[str, Any]]:
    """The events of a flight's log, which begins with the time of day; raises UsageError."""
    events = event_log.read(path)
    if events[0]["event"] != "log_opened":
        raise UsageError(f"{path} is not the event log of a flight")
    try:
        msgspec.convert([event for event in events if event["event"] == "log_opened"], list[_Opening])
    except msgspec.ValidationError as error:
        raise UsageError(f"{path} is not an event log: {error}") from error
    return events


def _seconds_since(events: Sequence[Mapping[str, Any]], now: datetime) -> float:
    """The time now of the last run in the log: by the time of day, unless that has gone back since."""
    opened = datetime.fromisoformat(
        next(event["time"] for event in reversed(events) if event["event"] == "log_opened")
    )
    last_s: float = events[-1]["t"]
    return max(last_s, (now - opened).total_seconds())


def _cut_torn_line(path: Path) -> None:
    content = path.read_bytes()
    os.truncate(path, content.rfind(b"\n") + 1)


def _printable(fact: object) -> object:
    return fact if isinstance(fact, (int, float)) else str(fact).encode(errors="backslashreplace").decode()


class JournalNotifier:
    """Tells the user through the event log, and so through whatever shows it."""

    def __init__(self, journal: FileJournal) -> None:
        self._journal = journal

    async def notify(self, message: object, at: Position) -> None:
        """Records the message with its place."""
        self._journal.record("notified", message=msgspec.to_builtins(message), at=msgspec.to_builtins(at))
