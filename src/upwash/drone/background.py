"""When the drone looks for servers, whatever its mission does: once a period, and at each border of a range."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import NoReturn

from upwash.core.events import Tick
from upwash.core.geo import Circle
from upwash.drone.decisions import Decisions
from upwash.errors import AutopilotLost
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal


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

    async def look(self) -> NoReturn:
        """Looks once a period, and at once for another server where a decision has left one."""
        again = self._decisions.server_left
        while True:
            self._decisions.tell(Tick())
            again.clear()
            alarm = asyncio.get_running_loop().call_later(self._period_s, again.set)
            await again.wait()
            alarm.cancel()

    async def watch_borders(self) -> NoReturn:
        """Looks at once where a border is crossed; while the vehicle is silent, once a period has to do."""
        silent = False
        while True:
            try:
                await self._autopilot.border_crossed(self._areas)
            except AutopilotLost as error:
                if not silent:
                    self._journal.record(schema.BorderWatchFailed(why=str(error)))
                silent = True
                await asyncio.sleep(self._period_s)
            else:
                silent = False
                self._decisions.tell(Tick())
