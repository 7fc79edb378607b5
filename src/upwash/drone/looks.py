"""The looks at the servers: once a period, and at each border of a range; none while nothing can have changed."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from upwash.core.geo import Circle
from upwash.core.selection.events import Tick
from upwash.errors import AutopilotLost
from upwash.eventlog import schema
from upwash.ports import Journal, Whereabouts
from upwash.support.background import now_s

_ROUNDING_S = 1e-6  # a look may be early by this, rather than late by a period


@dataclass(eq=False)
class Looks:
    """Has the core consider servers again and again, until its tasks are cancelled.

    `tick` does that. Until `next_look_s` nothing changes without an event. Set `again` to have it look at once, as
    after a decision on a call that left a server.
    """

    tick: Callable[[Tick], object]
    next_look_s: Callable[[], float]
    areas: Sequence[Circle]
    period_s: float
    autopilot: Whereabouts
    journal: Journal
    again: asyncio.Event = field(default_factory=asyncio.Event, init=False)
    _is_looking: bool = field(default=False, init=False)
    _silent: bool = field(default=False, init=False)  # the vehicle is, so that borders may be crossed unseen
    _looked_s: float = field(default=0.0, init=False)
    _due_s: float = field(default=-math.inf, init=False)  # of the next possible change
    _alarm: asyncio.TimerHandle | None = field(default=None, init=False)  # at the first look from then on

    async def look(self) -> NoReturn:
        """Tick the core after each period that can have changed its inputs, and at once after a server was left."""
        self._is_looking = True
        try:
            while True:
                self.tick(Tick())
                self.again.clear()
                self._looked_s = now_s()
                self._stop_alarm()
                self.set_alarm()
                await self.again.wait()
        finally:
            self._is_looking = False
            self._stop_alarm()

    async def watch_borders(self) -> NoReturn:
        """Tell the core at once when a border is crossed; once a period while the vehicle is silent."""
        while True:
            try:
                await self.autopilot.border_crossed(self.areas)
            except AutopilotLost as error:
                if not self._silent:
                    self.journal.record(schema.BorderWatchFailed(why=str(error)))
                self._silent = True
                self.set_alarm()
                await asyncio.sleep(self.period_s)
            else:
                self._silent = False
                self.tick(Tick())

    def set_alarm(self) -> None:
        """Schedule the next tick at the end of the first period that can have changed the core's inputs."""
        if not self._is_looking:
            return
        due_s = -math.inf if self._silent else self.next_look_s() - _ROUNDING_S
        if due_s == self._due_s and self._alarm is not None:
            return
        self._stop_alarm()
        self._due_s = due_s
        if due_s < math.inf:
            loop, look_s = asyncio.get_running_loop(), self._looked_s + self.period_s
            while look_s < max(due_s, loop.time()):
                look_s += self.period_s
            self._alarm = loop.call_at(look_s, self.again.set)

    def _stop_alarm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
