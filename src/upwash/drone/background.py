"""When the drone looks for servers, whatever its mission does: once a period, and at each border of a range.

Of the looks once a period those are left out at which nothing can have changed: the core knows when something can.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import NoReturn

from upwash.core.geo import Circle
from upwash.core.selection.events import Tick
from upwash.drone.decisions import Decisions
from upwash.errors import AutopilotLost
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal

_ROUNDING_S = 1e-6  # by which a look may be too early rather than a period too late


class Background:
    """Has the core look again, until its tasks are cancelled."""

    def __init__(
        self,
        decisions: Decisions,
        areas: Sequence[Circle],
        *,
        period_s: float,
        autopilot: Autopilot,
        journal: Journal,
    ) -> None:
        self._decisions = decisions
        self._areas = areas
        self._period_s = period_s
        self._autopilot = autopilot
        self._journal = journal
        self._silent = False  # the vehicle is, so that borders may be crossed unseen
        self._looked_s = 0.0
        self._due_s = -math.inf  # when something can have changed
        self._alarm: asyncio.TimerHandle | None = None  # at the first look from then on

    async def look(self) -> NoReturn:
        """Looks once a period where it is worth it, and at once for another server where a decision has left one."""
        again, loop = self._decisions.server_left, asyncio.get_running_loop()
        self._decisions.looked_after = self._set_alarm
        try:
            while True:
                self._decisions.tell(Tick())
                again.clear()
                self._looked_s = loop.time()
                self._stop_alarm()
                self._set_alarm()
                await again.wait()
        finally:
            self._decisions.looked_after = lambda: None
            self._stop_alarm()

    async def watch_borders(self) -> NoReturn:
        """Looks at once where a border is crossed; while the vehicle is silent, once a period has to do."""
        while True:
            try:
                await self._autopilot.border_crossed(self._areas)
            except AutopilotLost as error:
                if not self._silent:
                    self._journal.record(schema.BorderWatchFailed(why=str(error)))
                self._silent = True
                self._set_alarm()
                await asyncio.sleep(self._period_s)
            else:
                self._silent = False
                self._decisions.tell(Tick())

    def _set_alarm(self) -> None:
        """Has the next look made at the end of the first period by which something can have changed."""
        due_s = -math.inf if self._silent else self._decisions.next_look_s() - _ROUNDING_S
        if due_s == self._due_s and self._alarm is not None:
            return
        self._stop_alarm()
        self._due_s = due_s
        if due_s < math.inf:
            loop = asyncio.get_running_loop()
            self._alarm = loop.call_at(self._look_s(max(due_s, loop.time())), self._decisions.server_left.set)

    def _look_s(self, due_s: float) -> float:
        """The end of the first period, counted from the last look, that is no earlier."""
        look_s = self._looked_s + self._period_s
        while look_s < due_s:
            look_s += self._period_s
        return look_s

    def _stop_alarm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
