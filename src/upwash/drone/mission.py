"""Runs a blocking mission program in a thread of its own beside the event loop.

A mission is plain Python that calls blocking verbs. Each verb is a coroutine on the loop; the mission's thread
sleeps until it has ended. On a loop of virtual time the two take turns: the loop stands still while mission code
runs, so that the code takes no time and every run is the same; and the thread runs the loop while it waits. See
docs/decisions/blocking-missions.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import traceback
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar, cast

from upwash.errors import MissionFailed, MissionStopped, UpwashError, UsageError
from upwash.support.background import begin, thread
from upwash.support.text import worded

T = TypeVar("T")

_UPWASH = Path(__file__).parents[1]
_OTHER_THREAD = (
    "a verb or a call came from another thread than the mission's, which alone flies the drone: to go on while a "
    "call runs, start it with drone.start(...)"
)
_ONLY_MESSAGES = (
    "the mission tells an answer while the drone may be on a leg: only drone.user.notify is possible there; for an "
    "act at the answer's place use drone.stay_or_go(pending, act)"
)
_GRACE_S = 5.0  # for a mission's own last words, once it has been stopped


class LoopTurn(Protocol):
    """The turn of a mission's thread on a loop of virtual time."""

    def give(self) -> None:
        """In a callback of the loop: let the mission's code run next, before any other callback."""

    def begin(self) -> None:
        """In the mission's thread, first of all: returns when the mission's code may run."""

    def wait(self) -> None:
        """In the mission's thread: wait until its code may go on."""

    def end(self) -> None:
        """In the mission's thread, last of all: give the turn back to the loop."""


class MissionThread:
    """One mission's thread; create it on the event loop that runs its verbs."""

    def __init__(self, *, grace_s: float = _GRACE_S) -> None:
        self._grace_s = grace_s
        self._loop = asyncio.get_running_loop()
        self._ended: asyncio.Future[Exception | None] = self._loop.create_future()
        self._thread: threading.Thread | None = None  # noqa: TID251 - once it runs
        self._stopped = ""  # why, once it is
        self._only_messages = False
        self._verb: asyncio.Task[Any] | None = None
        self._ended_verbs: SimpleQueue[asyncio.Task[Any]] = SimpleQueue()
        # A loop of virtual time gives each mission's thread a turn of its own.
        self._turn: LoopTurn | None = getattr(self._loop, "mission_turn", lambda: None)()

    def call(self, verb: Coroutine[Any, Any, T], *, is_message: bool = False) -> T:
        """Runs a verb on the loop and returns its result.

        Raises UsageError in any thread but the mission's, and MissionStopped from `stop` on.
        """
        try:
            self.require_turn(is_message=is_message)
        except UpwashError:
            verb.close()
            raise
        self._loop.call_soon_threadsafe(self._begin, verb)
        if self._turn is not None:
            self._turn.wait()
        ended = self._ended_verbs.get()
        if ended.cancelled():
            raise MissionStopped(self._stopped or "the program is ending")
        return cast(T, ended.result())

    @contextlib.contextmanager
    def only_messages(self) -> Iterator[None]:
        """Raise UsageError for other verbs than messages during the block, in the mission's thread."""
        self._only_messages = True
        try:
            yield
        finally:
            self._only_messages = False

    def post(self, do: Callable[[], object]) -> None:
        """Have the loop call `do` before the mission's next verb, without waiting for it."""
        self.require_turn()
        self._loop.call_soon_threadsafe(do)

    async def run(self, program: Callable[[], None]) -> None:
        """Runs the program in the thread until it ends, or shortly after `stop`; raises the program's exception."""

        def body() -> None:
            if self._turn is not None:
                self._turn.begin()
            failure: Exception | None = None
            try:
                program()
            except Exception as error:  # noqa: BLE001 - carried over to the loop, not swallowed
                failure = error
            except BaseException as error:  # noqa: BLE001 - sys.exit() ends the mission, not the program
                failure = MissionStopped(f"the mission raised {worded(error)}")
            self._settle_from_thread(failure)
            if self._turn is not None:
                self._turn.end()

        self._thread = thread(body, name="mission", failed=self._settle_from_thread)
        self._thread.start()
        self._give_turn()
        try:
            failure = await self._ended
        except asyncio.CancelledError:
            self.stop("the flight was cancelled")
            raise
        if failure is not None:
            raise failure

    def stop(self, why: str) -> None:
        """Ends the mission in the verb under way, or at its next verb; for the loop's thread only.

        A mission that computes on, or ignores MissionStopped, is abandoned: none of its verbs has an effect any more.
        """
        self._stopped = self._stopped or why
        self._loop.call_later(self._grace_s, self._settle, MissionStopped(self._stopped))
        if self._verb is not None:
            self._verb.cancel()

    def require_turn(self, *, is_message: bool = False) -> None:
        """Raises UsageError in any thread but the mission's, and MissionStopped from `stop` on."""
        if threading.current_thread() is not self._thread:
            raise UsageError(_OTHER_THREAD)
        if self._stopped:
            raise MissionStopped(self._stopped)
        if self._only_messages and not is_message:
            raise UsageError(_ONLY_MESSAGES)

    def _settle_from_thread(self, failure: Exception | None) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._settle, failure)

    def _settle(self, failure: Exception | None) -> None:
        if not self._ended.done():
            self._ended.set_result(failure)

    def _begin(self, verb: Coroutine[Any, Any, Any]) -> None:
        self._verb = begin(verb)
        self._verb.add_done_callback(self._end)
        if self._stopped:  # between the call and now
            self._verb.cancel()

    def _end(self, verb: asyncio.Task[Any]) -> None:
        self._verb = None
        self._ended_verbs.put(verb)
        self._give_turn()

    def _give_turn(self) -> None:
        if self._turn is not None:
            self._turn.give()


def mission_failed(error: Exception) -> MissionFailed:
    """The MissionFailed for an exception of the mission program, with a trace without the lines of this package."""
    trace = traceback.TracebackException.from_exception(error)
    own = [frame for frame in trace.stack if not Path(frame.filename).is_relative_to(_UPWASH)]
    if own:  # else the mission is a bundled one
        trace.stack = traceback.StackSummary.from_list(own)
    return MissionFailed(f"the mission program raised {worded(error)}", "".join(trace.format()).rstrip())
