"""An event log in memory."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from upwash.core.geo import Position


class MemoryJournal:
    """Keeps events as the file journal would have written them; it is the notifier too."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self) -> None:
        """Takes the time of the event loop that runs."""
        self._loop = asyncio.get_running_loop()

    def record(self, event: str, **facts: object) -> None:
        """Adds one event."""
        assert self._loop is not None  # noqa: S101 - begin() was called
        self.events.append({"t": round(self._loop.time(), 6), "event": event, **facts})

    async def notify(self, message: object, at: Position) -> None:
        """Records a message to the user."""
        self.record("notified", message=msgspec.to_builtins(message), at=msgspec.to_builtins(at))
