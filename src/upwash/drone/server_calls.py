"""What a drone in flight asks of its calls that only servers compute: how soon they are answered, and their end."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from upwash.core.call import steps
from upwash.core.call.on_servers import patience_s
from upwash.core.operation import Operation


class _Waiting(Protocol):
    def waiting(self) -> Sequence[Operation]: ...
    def reach_s(self, operation: Operation) -> float | None: ...
    def tell(self, event: steps.EndWaiting) -> None: ...


class ServerCalls:
    """The open calls that only servers compute; `happened` waits for the core's next event.

    `alone_s` returns the seconds of a call on servers alone that is worth a stop.
    """

    def __init__(
        self,
        calls: _Waiting,
        happened: Callable[[], Awaitable[None]],
        alone_s: Callable[[Operation], float | None],
    ) -> None:
        self._calls = calls
        self._happened = happened
        self._alone_s = alone_s

    @property
    def waiting(self) -> Sequence[Operation]:
        """Their operations, the oldest first."""
        return self._calls.waiting()

    async def soon_s(self, operation: Operation) -> float | None:
        """Seconds until a call made now is answered here; None if a stop is not worth it."""
        reach_s, alone_s = self._calls.reach_s(operation), self._alone_s(operation)
        if reach_s is None or alone_s is None:
            return None
        soon_s = reach_s * max(1, len(self.waiting))
        return soon_s if soon_s <= alone_s else None

    async def end_all(self, why: str) -> None:
        """End all calls that wait; return when they are over."""
        self._calls.tell(steps.EndWaiting(why))
        while self.waiting:
            await self._happened()

    async def answered_here(self, at_most_s: float = math.inf) -> None:
        """Return when no call waits, or when no server in range answers the next one, and after that time at most."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(at_most_s if at_most_s < math.inf else None):
                while self.waiting:
                    reaches = [self._calls.reach_s(operation) for operation in dict.fromkeys(self.waiting)]
                    reach_s = max((reach_s for reach_s in reaches if reach_s is not None), default=None)
                    if reach_s is None:
                        return
                    count = len(self.waiting)
                    async with asyncio.timeout(patience_s(reach_s)):
                        while len(self.waiting) == count:
                            await self._happened()
