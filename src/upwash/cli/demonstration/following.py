"""The events of flights of other programs, as their logs grow."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path

from upwash.errors import UsageError
from upwash.eventlog.log import LineReader
from upwash.eventlog.schema import Event
from upwash.support.background import beside
from upwash.view.tail import Tail

_LOOK_S = 0.1
_log = logging.getLogger("upwash.demonstration")


@contextlib.asynccontextmanager
async def followed(logs: Mapping[str, Path], follow: Callable[[str, Event], None]) -> AsyncIterator[None]:
    """Tells `follow` each event of each drone's log, soon after it is there, until the end of the block.

    By then it was told all of them. The logs have to be there. One that cannot be read is followed no further.
    """
    with contextlib.ExitStack() as stack:
        growing = {
            drone: stack.enter_context(contextlib.closing(_Growing(log))) for drone, log in logs.items()
        }

        def look() -> None:
            for drone, log in growing.items():
                for event in log.news():
                    follow(drone, event)

        async def watch() -> None:
            while True:
                look()
                await asyncio.sleep(_LOOK_S)

        try:
            async with beside(watch(), name="the reader of the flights' logs"):
                yield
        finally:
            look()


class _Growing:
    """One log."""

    def __init__(self, log: Path) -> None:
        self._tail = Tail(log)
        self._lines = LineReader(log)
        self._readable = True

    def news(self) -> Iterator[Event]:
        """The events since it was asked last."""
        try:
            while self._readable and (lines := self._tail.read()) is not None:
                yield from self._lines.take_all(lines)
        except UsageError as error:
            self._readable = False
            _log.warning("%s", error)

    def close(self) -> None:
        """Lets go of it."""
        self._tail.close()
