"""An asyncio event loop on virtual time: instead of waiting for the next timer, its clock jumps there.

Everything else is asyncio's own. What would wait for the outside world (sockets, processes, threads) is refused,
as the clock would have jumped past it; and where nothing is scheduled at all, the loop says so instead of
hanging.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import threading
from asyncio import base_events
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextvars import Context
from typing import Any, NoReturn, TypeVar

from upwash.errors import UpwashError

T = TypeVar("T")

_LONGEST_TURN_S = 300.0  # of real time: a mission's code that takes longer between two verbs never ends
_MOST_TURNS = 100_000  # without time going on: a thousand times what a flight with a hundred servers needs


class DeadlockError(UpwashError):
    """Every task waits, and nothing is scheduled that could wake one."""


class LivelockError(UpwashError):
    """Something goes on for ever, and time does not."""


class OutsideWorldError(UpwashError):
    """Something was asked for that does not exist on virtual time."""


def run_virtually(main: Coroutine[Any, Any, T]) -> T:
    """Runs a coroutine to its end on a virtual clock that starts at 0; returns or raises what it does."""
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
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)


class _Timer(asyncio.TimerHandle):
    """Else which of two runs first would follow from timers that have nothing to do with either."""

    __slots__ = ("number",)
    number: int

    def __lt__(self, other: object) -> bool:
        if not isinstance(other, _Timer):
            return NotImplemented
        mine_s, others_s = self.when(), other.when()
        return mine_s < others_s or (mine_s == others_s and self.number < other.number)


class VirtualLoop(base_events.BaseEventLoop):
    """Runs what is ready in the order in which it became so, timers by their time."""

    def __init__(self) -> None:
        super().__init__()
        self._now_s = 0.0
        self._turns = 0  # of the loop since time last went on
        self._stuck = False  # a mission kept its turn
        self._numbers = itertools.count()  # of timers
        self._clock_resolution = 1e-9  # the base class runs what is due before now plus this
        self._selector = self  # the base class asks its selector for events: here, time is the only one

    def time(self) -> float:
        """The virtual time in seconds."""
        return self._now_s

    def stand_still(self, until: threading.Event) -> None:
        """Lets a mission's code run while time does not: returns when the event is set, or it takes for ever."""
        if not until.wait(_LONGEST_TURN_S):
            self._stuck = True

    def call_at(  # type: ignore[override]
        self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """A timer; of those of the same instant the one that was set first runs first."""
        timer = _Timer(when, callback, args, self, context)
        timer.number = next(self._numbers)
        heapq.heappush(self._scheduled, timer)  # type: ignore[attr-defined]
        timer._scheduled = True  # type: ignore[attr-defined]
        return timer

    # --- what the base class calls --------------------------------------------------------------------------

    def select(self, timeout: float | None) -> list[NoReturn]:
        """Jumps to the next timer instead of waiting for it."""
        if self._stuck:
            self._stuck = False  # so that what is cancelled now can end
            raise LivelockError(
                f"the mission's own code has run for {_LONGEST_TURN_S:.0f} s without calling a verb, "
                f"and at {self._now_s:.3f} s everything else waits for it"
            )
        if timeout is None:
            raise DeadlockError(f"everything waits and nothing is scheduled: {self._waiting()}")
        if timeout == 0:
            self._turns += 1
            if self._turns > _MOST_TURNS:
                self._turns = 0
                raise LivelockError(
                    f"after {_MOST_TURNS} turns it is still {self._now_s:.3f} s: a mission that loops over verbs "
                    f"which take no time, or programs that answer each other at once; {self._waiting()}"
                )
        else:
            self._turns = 0
            self._now_s = max(self._now_s, self._scheduled[0].when())  # type: ignore[attr-defined]
        return []

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
        """Refused."""
        raise OutsideWorldError(f"a thread for {func!r} would run on another clock than the simulation")

    async def create_connection(self, *_: Any, **__: Any) -> Any:
        """Refused, as every way to the network is."""
        raise OutsideWorldError("there are no sockets on virtual time")

    create_server = create_connection
    create_datagram_endpoint = create_connection
    create_unix_connection = create_connection
    create_unix_server = create_connection

    async def subprocess_exec(self, *_: Any, **__: Any) -> Any:
        """Refused, as every process is."""
        raise OutsideWorldError("there are no processes on virtual time")

    subprocess_shell = subprocess_exec
