"""Runs a blocking mission program in a thread of its own beside the event loop.

A mission is plain Python that calls blocking verbs. Each verb is a coroutine on the loop; the mission's thread
sleeps until it has ended. See docs/decisions/blocking-missions.md.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError, Future
from typing import Any, TypeVar

from upwash.errors import MissionStopped

T = TypeVar("T")


class MissionThread:
    """One mission's thread; made on the event loop that runs its verbs."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stopped = ""  # why, once it is
        self._verb: Future[Any] | None = None

    def call(self, verb: Coroutine[Any, Any, T]) -> T:
        """Runs a verb on the loop and returns its result; for the mission's thread only.

        Raises MissionStopped, now and ever after, once the mission is being ended from outside.
        """
        if self._stopped:
            verb.close()
            raise MissionStopped(self._stopped)
        running = asyncio.run_coroutine_threadsafe(verb, self._loop)
        self._verb = running
        try:
            return running.result()
        except CancelledError:
            raise MissionStopped(self._stopped or "the program is ending") from None

    async def run(self, program: Callable[[], None]) -> None:
        """Runs the program to its end; raises what it raises. A daemon thread: it cannot hold up the exit."""
        ended = self._loop.create_future()

        def report(error: BaseException | None) -> None:
            if ended.done():
                return
            if error is None:
                ended.set_result(None)
            else:
                ended.set_exception(error)

        def body() -> None:
            error: BaseException | None = None
            try:
                program()
            except BaseException as raised:  # noqa: BLE001 - carried over to the loop, not swallowed
                error = raised
            if not self._loop.is_closed():
                self._loop.call_soon_threadsafe(report, error)

        threading.Thread(target=body, name="mission", daemon=True).start()
        await ended

    def stop(self, why: str) -> None:
        """Ends the mission at its next verb, or in the one under way; for the loop's thread only."""
        self._stopped = self._stopped or why
        if self._verb is not None:
            self._verb.cancel()
