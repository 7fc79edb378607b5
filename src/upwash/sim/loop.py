"""An asyncio event loop on virtual time: instead of waiting for the next timer, its clock jumps there.

Waits for the outside world (sockets, processes, threads) are refused, as the clock would jump past them. If every
task waits and nothing is scheduled, the loop raises DeadlockError instead of hanging.

Threads take turns (turns.py): a thread that waits runs the loop meanwhile, so that a mission's verb needs no change
of threads. Tasks, futures and everything else are asyncio's own.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
from asyncio import base_events
from collections import deque
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextvars import Context
from typing import Any, NoReturn, TypeVar

from upwash.errors import UpwashError
from upwash.sim.turns import Interrupts, MissionTurn, OverstayedError, RunningTurn, ThreadTurns

T = TypeVar("T")

ALIKE_S = 1e-9  # timers that are no further apart are due together
_FEW_TIMERS = 100  # as many as may be cancelled before they are looked through
_MOST_ROUNDS = 100_000  # without time going on: a thousand times what a flight with a hundred servers needs


class DeadlockError(UpwashError):
    """Every task waits, and nothing is scheduled that could wake one."""


class LivelockError(UpwashError):
    """Work continues for ever at one moment."""


class OutsideWorldError(UpwashError):
    """A socket, thread or process was requested, which virtual time does not have."""


def run_virtually(main: Coroutine[Any, Any, T]) -> T:
    """Runs a coroutine to its end on a virtual clock that starts at 0; returns its result or raises its error."""
    if not _a_loop_runs_here():
        return _run(main)
    with ThreadPoolExecutor(
        1
    ) as other:  # a thread has one running loop, and in a notebook there already is one
        return other.submit(_run, main).result()


def _a_loop_runs_here() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def _run(main: Coroutine[Any, Any, T]) -> T:
    # Not the runner's own `run`: it cancels on Ctrl-C from a thread that does not run the loop.
    with Interrupts() as interrupts, asyncio.Runner(loop_factory=VirtualLoop) as runner:
        loop = runner.get_loop()
        assert isinstance(loop, VirtualLoop)  # noqa: S101 - that is what was asked for
        interrupts.end(loop.turns)
        try:
            return loop.run_until_complete(main)
        finally:
            if loop.failure is not None:
                raise loop.failure


def end_run(failure: Exception) -> None:
    """End the present run on virtual time with the failure."""
    asyncio.get_running_loop().call_exception_handler({"message": str(failure), "exception": failure})


class VirtualLoop(base_events.BaseEventLoop):
    """An event loop on virtual time: runs ready callbacks in order, then timers by time and order of setting."""

    def __init__(self) -> None:
        super().__init__()
        self._now_s = 0.0
        self._ready: deque[asyncio.Handle]  # the base class's: ready callbacks, in order
        self._left = 0  # of them, those of this round: what they make ready is the next one's
        self._timers: list[tuple[float, int, asyncio.TimerHandle]] = []  # a heap
        self._numbers = itertools.count()  # of timers
        self._cancelled = 0  # timers that are still in the heap
        self._rounds = 0  # since time last went on
        self.turns = ThreadTurns()
        self.failure: BaseException | None = None  # the first unhandled one

    def time(self) -> float:
        """The virtual time in seconds."""
        return self._now_s

    def mission_turn(self) -> MissionTurn:
        """The turn of a new mission's thread."""
        return MissionTurn(self.turns, self, self._run_until)

    def close(self) -> None:
        """Close the loop; the threads of missions that are over have ended then."""
        super().close()
        self.turns.join()

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Ends the run with the unhandled failure of a callback or of a task.

        An UpwashError is ignored, as work may end with it.
        """
        failure = context.get("exception") or RuntimeError(context["message"])
        if isinstance(failure, UpwashError) or self.failure is not None:
            return
        self.failure = failure
        if self.is_running():
            self.stop()

    # These methods do the base class's work in fewer steps, as a mission calls them thousands of times. They do not
    # check the thread in debug mode: only the thread with the turn calls them.

    def call_soon(  # type: ignore[override]
        self, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.Handle:
        """Schedules the callback behind the ready ones; RuntimeError if the loop is closed."""
        if self._closed:  # type: ignore[attr-defined]
            raise RuntimeError("Event loop is closed")
        handle = asyncio.Handle(callback, args, self, context)
        self._ready.append(handle)
        return handle

    call_soon_threadsafe = call_soon  # type: ignore[assignment]

    def call_later(  # type: ignore[override]
        self, delay: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """A timer for `delay` seconds from now."""
        return self.call_at(self._now_s + delay, callback, *args, context=context)

    def call_at(  # type: ignore[override]
        self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """Sets a timer; timers of one instant run in the order of their setting."""
        timer = asyncio.TimerHandle(when, callback, args, self, context)
        heapq.heappush(self._timers, (when, next(self._numbers), timer))
        timer._scheduled = True  # type: ignore[attr-defined]
        return timer

    # --- rounds ---------------------------------------------------------------------------------------------

    def _run_once(self) -> None:
        """Run one round in the loop's own thread, or wait for the rounds of a mission's thread (base class hook)."""
        if not self._run_round(self.turns.own):
            return
        try:
            self.turns.wait_for_own()
        except OverstayedError as error:
            raise LivelockError(f"{error}, and at {self._now_s:.3f} s everything else waits for it") from None

    def _run_until(self, turn: RunningTurn) -> None:
        """Run rounds in this thread until it may go on with other code, or until the loop stops."""
        while not self._run_round(turn):
            if self._stopping:  # type: ignore[attr-defined]
                self.turns.next = self.turns.own
                return

    def _run_round(self, turn: RunningTurn) -> bool:
        """Run what is ready; return True, early, once a turn was given."""
        if not self._left:
            self._begin_round()
        ready, turns = self._ready, self.turns
        while self._left:
            self._left -= 1
            handle = ready.popleft()
            if not handle._cancelled:
                handle._run()
                if turns.next is not None:
                    return True
        return False

    def _begin_round(self) -> None:
        """Advance time to the next timer if nothing is ready; make due timers ready."""
        timers = self._timers
        while timers and timers[0][2]._cancelled:
            self._pop_timer()
        waits = not self._ready and not self._stopping  # type: ignore[attr-defined]
        if waits and not timers:
            raise DeadlockError(f"everything waits and nothing is scheduled: {self._waiting()}")
        if waits and timers[0][0] > self._now_s:
            self._now_s, self._rounds = timers[0][0], 0
        else:  # which a timer of no time is, too
            self._count_round()
        due_s = self._now_s + ALIKE_S
        while timers and timers[0][0] < due_s:
            self._ready.append(self._pop_timer())
        self._left = len(self._ready)

    def _count_round(self) -> None:
        self._rounds += 1
        if self._rounds > _MOST_ROUNDS:
            self._rounds = 0
            raise LivelockError(
                f"after {_MOST_ROUNDS} turns it is still {self._now_s:.3f} s: a mission that loops over verbs "
                f"which take no time, or programs that answer each other at once; {self._waiting()}"
            )

    def _pop_timer(self) -> asyncio.TimerHandle:
        timer = heapq.heappop(self._timers)[2]
        timer._scheduled = False  # type: ignore[attr-defined]
        self._cancelled -= timer._cancelled
        return timer

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """Count a cancelled timer; drop them once they are most of the heap (base class hook)."""
        if not handle._scheduled:  # type: ignore[attr-defined]
            return
        self._cancelled += 1
        if self._cancelled > _FEW_TIMERS and 2 * self._cancelled > len(self._timers):
            self._timers = [timer for timer in self._timers if not timer[2]._cancelled]
            heapq.heapify(self._timers)
            self._cancelled = 0

    # --- what the base class calls --------------------------------------------------------------------------

    def _process_events(self, events: list[NoReturn]) -> None:
        pass

    def _write_to_self(self) -> None:
        pass  # nothing sleeps that another thread would have to wake

    def _waiting(self) -> str:
        return ", ".join(
            sorted(f"{task.get_name()} ({task.get_coro()!r})" for task in asyncio.all_tasks(self))
        )

    # --- what does not exist here ---------------------------------------------------------------------------

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> Any:  # type: ignore[override]
        """Raises OutsideWorldError."""
        raise OutsideWorldError(f"a thread for {func!r} would run on another clock than the simulation")

    async def create_connection(self, *_: Any, **__: Any) -> Any:
        """Raises OutsideWorldError, as every use of the network."""
        raise OutsideWorldError("there are no sockets on virtual time")

    create_server = create_connection
    create_datagram_endpoint = create_connection
    create_unix_connection = create_connection
    create_unix_server = create_connection

    async def subprocess_exec(self, *_: Any, **__: Any) -> Any:
        """Raises OutsideWorldError, as every start of a process."""
        raise OutsideWorldError("there are no processes on virtual time")

    subprocess_shell = subprocess_exec
