"""The vehicle's clock: the event loop's, or one that runs faster."""

from __future__ import annotations

import asyncio


class Clock:
    """Shows the event loop's time at first, and goes on `speedup` times as fast."""

    def __init__(self, speedup: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._speedup = speedup
        self._started_s = self._loop.time()

    def now_s(self) -> float:
        """Its time."""
        return self._started_s + (self._loop.time() - self._started_s) * self._speedup

    async def sleep_until(self, time_s: float) -> None:
        """Returns when the clock shows the time, and not before others had their turn."""
        await asyncio.sleep(max(0.0, (time_s - self.now_s()) / self._speedup))
