"""The event log as a file of JSON lines, the truth about a run."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from upwash.core.geo import Position
from upwash.errors import UsageError

Watcher = Callable[[Mapping[str, Any]], None]


class FileJournal:
    """Appends each event as one line in one write, so that a crash leaves no torn line behind.

    `t` counts seconds of the event loop's clock from the first event; that one also tells the time of day.
    """

    def __init__(self, path: Path, *, watchers: tuple[Watcher, ...] = ()) -> None:
        self.path = path
        self._watchers = watchers
        self._loop = asyncio.get_running_loop()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UsageError(f"cannot write the event log {path}: {error.strerror}") from error
        self._began_s = self._loop.time()
        self.record("log_opened", time=datetime.fromtimestamp(time.time(), UTC).isoformat())

    def record(self, event: str, **facts: object) -> None:
        """Adds one event with its facts; it is in the file when this returns."""
        entry = {"t": round(self._loop.time() - self._began_s, 6), "event": event, **facts}
        os.write(self._file, msgspec.json.encode(entry) + b"\n")
        for watch in self._watchers:
            watch(entry)

    def close(self) -> None:
        """Ends the log."""
        os.close(self._file)


class JournalNotifier:
    """Tells the user through the event log, and so through whatever shows it."""

    def __init__(self, journal: FileJournal) -> None:
        self._journal = journal

    async def notify(self, message: object, at: Position) -> None:
        """Records the message with its place."""
        self._journal.record("notified", message=msgspec.to_builtins(message), at=msgspec.to_builtins(at))
