"""An event log without a file of its own."""

from __future__ import annotations

import asyncio

import msgspec

from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.eventlog.fitting import fitted
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.schema import Event
from upwash.sim.energy import EnergyMeter
from upwash.sim.link import Life


class MemoryJournal:
    """Keeps events as the file journal would have written them; it is the notifier too.

    With a meter it says what was drawn just before it keeps the mission's end. Once the drone's life is over it keeps
    nothing more.
    """

    def __init__(self) -> None:
        self.events = KeptEvents()
        self.meter: EnergyMeter | None = None
        self.life = Life()
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self) -> None:
        """Takes the time of the event loop that runs."""
        self._loop = asyncio.get_running_loop()

    def record(self, event: Event) -> None:
        """Adds one event."""
        assert self._loop is not None  # noqa: S101 - begin() was called
        if self.life.is_over:
            return
        if self.meter is not None and isinstance(event, (schema.MissionCompleted, schema.MissionEnded)):
            self.record(self.meter.used())
        for entry in fitted(msgspec.structs.replace(event, t=round(self._loop.time(), 6))):
            self.events.append(entry)

    async def notify(self, message: object, at: Position) -> None:
        """Records a message to the user."""
        self.record(schema.Notified(message=msgspec.to_builtins(message), at=at))
