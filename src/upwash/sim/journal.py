"""An event log without a file of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import msgspec

from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.eventlog.fitting import fitted
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.schema import Event
from upwash.sim.energy import EnergyMeter
from upwash.sim.link import Life


class MemoryJournal:
    """Keeps events in memory, as the file journal would write them; it is the notifier too.

    With a meter it records the energy used just before the mission's end. After the end of the drone's life it keeps
    nothing.
    """

    def __init__(self) -> None:
        self.events = KeptEvents()
        self.meter: EnergyMeter | None = None
        self.life = Life()
        self.arrived: Callable[[], object] = lambda: None  # called at each waypoint
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self) -> None:
        """Use the clock of the running event loop."""
        self._loop = asyncio.get_running_loop()

    def record(self, event: Event) -> None:
        """Adds one event."""
        assert self._loop is not None  # noqa: S101 - begin() was called
        if self.life.is_over:
            return
        if isinstance(event, schema.Arrived):
            self.arrived()
        if self.meter is not None and isinstance(event, (schema.MissionCompleted, schema.MissionEnded)):
            self.record(self.meter.used())
        for entry, _ in fitted(msgspec.structs.replace(event, t=round(self._loop.time(), 6))):
            self.events.append(entry)

    async def notify(self, message: object, at: Position, photo: int | None = None) -> None:
        """Records a message to the user."""
        self.record(schema.Notified(message=msgspec.to_builtins(message), at=at, photo=photo))
