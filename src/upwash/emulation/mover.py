"""Tells a radio where the drones are, in real time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from upwash.core.geo import Position
from upwash.emulation.field import Radio

_PERIOD_S = 0.1


class Mover:
    """Tells the radio ten times a second where the drones are."""

    def __init__(self, radio: Radio, positions: Mapping[str, Callable[[], Position]]) -> None:
        self.lag_s = 0.0
        self._radio = radio
        self._positions = positions

    async def run(self) -> None:
        """Moves them until cancelled; raises UpwashError where the radio has failed."""
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            for drone, position in self._positions.items():
                self._radio.move(drone, position())
            self.lag_s = max(self.lag_s, loop.time() - due_s)
            due_s = max(due_s + _PERIOD_S, loop.time())
            await asyncio.sleep(due_s - loop.time())
