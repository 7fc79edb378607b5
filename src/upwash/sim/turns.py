"""The turns of a simulation's threads, the loop's own and the missions': one runs at a time. Missions that sleep.

A mission's thread begins a verb and then runs the loop itself until the verb has ended, instead of waking another
thread and waiting: a change of thread costs more than everything else in a verb. Two threads change only where the
verb of another mission ends first. The loop's own thread waits meanwhile, and watches that missions go on:

    loop's own      runs ──give──┐                                     ┌─end── runs
    mission 1                    code ─wait─ runs ─give─ code ─wait─ ──┘
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import SupportsIndex

from upwash.errors import UpwashError

_LONGEST_TURN_S = 300.0  # of real time: a mission's code that takes longer between two verbs never ends
_LOOK_AGAIN_S = 0.1  # whether the thread that runs the loop has stopped


class OverstayedError(UpwashError):
    """Raised when a mission's code runs for too long without a verb."""


class RunningTurn:
    """The turn of one thread."""

    __slots__ = ("come",)

    def __init__(self) -> None:
        self.come = threading.Lock()  # to be had once the turn has come
        self.come.acquire()


class ThreadTurns:
    """Passes the turn from thread to thread; `next` is the turn after the present callback."""

    def __init__(self) -> None:
        self.own = RunningTurn()
        self.next: RunningTurn | None = None
        self._holder = self.own
        self._runs_loop = True  # the holder does, rather than a mission's code
        self._begun = 0  # turns of missions' code
        self._failure: BaseException | None = None  # of the loop in a mission's thread
        self._interrupted = False
        self._changing = threading.Lock()
        self._gone: list[threading.Thread] = []  # noqa: TID251 - that ended, or are about to

    def wait_for_own(self) -> None:
        """In the loop's own thread: let the next thread go on; returns when it is this thread's turn again.

        Raises the loop's error, KeyboardInterrupt after an interrupt, and OverstayedError if a mission keeps its
        turn.
        """
        self._pass_on()
        try:
            begun = -1
            while not self.own.come.acquire(timeout=_LONGEST_TURN_S):
                if not self._runs_loop and begun == self._begun:
                    raise OverstayedError(
                        f"the mission's own code has run for {_LONGEST_TURN_S:.0f} s without calling a verb"
                    )
                begun = self._begun
        except BaseException:
            self._take_back()
            raise
        if self._interrupted:
            self._interrupted = False
            raise KeyboardInterrupt
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def interrupt(self) -> None:
        """In the loop's own thread, by a signal: end a mission's code at once, or the loop after its callback."""
        if not self._runs_loop:
            raise KeyboardInterrupt  # out of the wait for the mission's code
        self._interrupted, self.next = True, self.own

    def begin_code(self) -> None:
        """In a mission's thread with the turn: note that its code runs now."""
        self._runs_loop = False
        self._begun += 1

    def end_code(self, turn: RunningTurn) -> bool:
        """In a mission's thread: let the loop run; return False if the turn was taken from this thread."""
        with self._changing:
            if self._holder is not turn:
                return False
            self._runs_loop = True
            return True

    def leave(self, turn: RunningTurn) -> None:
        """In a mission's thread that ran the loop: let the next thread go on; returns at this thread's turn."""
        if self.next is turn:
            self.next = None
        else:
            self._pass_on()
            turn.come.acquire()

    def leave_for_good(self) -> None:
        """In a mission's thread that ends: let the loop's own thread go on."""
        self._gone.append(threading.current_thread())
        self.next = self.own
        self._pass_on()

    def join(self) -> None:
        """In the loop's own thread: return when the threads that left for good have ended."""
        for gone in self._gone:
            gone.join()

    def fail(self, failure: BaseException) -> None:
        """In a mission's thread that ran the loop: pass the failure to the loop's own thread, which raises it."""
        self._failure, self.next = failure, self.own

    def _pass_on(self) -> None:
        with self._changing:
            turn = self.next or self.own
            self.next, self._holder = None, turn
        turn.come.release()

    def _take_back(self) -> None:
        """End the holder's turn: at once in a mission's code, else after the current callback."""
        while True:
            with self._changing:
                if self._holder is self.own:
                    break
                if not self._runs_loop:
                    self._holder, self._runs_loop, self.next = self.own, True, None
                    return
                self.next = self.own
            if self.own.come.acquire(timeout=_LOOK_AGAIN_S):
                return
        self.own.come.acquire()


class Interrupts:
    """Lets Ctrl-C end a simulation between two callbacks, as a callback could swallow it.

    KeyboardInterrupt is raised at the end at the latest; a second Ctrl-C raises it at once. Only the first thread
    of the process handles Ctrl-C, and only if the process has no other handler.
    """

    def __init__(self) -> None:
        self._turns: ThreadTurns | None = None
        self._came = False
        self._handles = (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        )

    def end(self, turns: ThreadTurns) -> None:
        """Let Ctrl-C end the run with these turns from now on."""
        self._turns = turns

    def __enter__(self) -> Interrupts:
        if self._handles:
            signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if self._came and kind is None:
            raise KeyboardInterrupt

    def _handle(self, *_: object) -> None:
        came, self._came = self._came, True
        if came:
            raise KeyboardInterrupt
        if self._turns is not None:
            self._turns.interrupt()


class MissionTurn(RunningTurn):
    """The turn of a mission's thread, which is outside the loop while its code runs."""

    __slots__ = ("_loop", "_run_until", "_turns")

    def __init__(
        self, turns: ThreadTurns, loop: asyncio.BaseEventLoop, run_until: Callable[[RunningTurn], None]
    ) -> None:
        super().__init__()
        self._turns = turns
        self._loop = loop
        self._run_until = run_until

    def give(self) -> None:
        """In a callback of the loop: let the mission's code run next, before any other callback."""
        self._turns.next = self

    def begin(self) -> None:
        """In the mission's thread, first of all: returns when the mission's code may run."""
        self.come.acquire()
        sys.set_asyncgen_hooks(
            firstiter=self._loop._asyncgen_firstiter_hook,  # type: ignore[attr-defined]
            finalizer=self._loop._asyncgen_finalizer_hook,  # type: ignore[attr-defined]
        )
        self._turns.begin_code()

    def wait(self) -> None:
        """In the mission's thread, whose code waits: runs the loop; returns when the code may go on."""
        if self._turns.end_code(self):
            asyncio._set_running_loop(self._loop)
            try:
                self._run_until(self)
            except BaseException as error:  # noqa: BLE001 - raised where the loop was started
                self._turns.fail(error)
            finally:
                asyncio._set_running_loop(None)
            self._turns.leave(self)
        else:
            self.come.acquire()
        self._turns.begin_code()

    def end(self) -> None:
        """In the mission's thread, last of all: give the turn back to the loop."""
        if self._turns.end_code(self):
            self._turns.leave_for_good()


_MISSION_THREAD = "mission"  # as mission.py names it


class _SleepWatch:
    """Replaces `time.sleep` while a simulation of this process runs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._simulations = 0
        self._sleep = time.sleep

    @contextlib.contextmanager
    def on(self) -> Iterator[None]:
        with self._lock:
            if self._simulations == 0:
                self._sleep, time.sleep = time.sleep, self.sleep
            self._simulations += 1
        try:
            yield
        finally:
            with self._lock:
                self._simulations -= 1
                if self._simulations == 0:
                    time.sleep = self._sleep

    def sleep(self, seconds: float | SupportsIndex, /) -> None:
        """Sleeps, except in a simulated mission, which is warned instead.

        A mission that imports the name during a simulation keeps this function for good, so each call checks.
        """
        if self._simulations == 0 or not _is_missions_code():
            self._sleep(seconds)
            return
        caller = sys._getframe(1)
        warnings.warn(
            f"time.sleep({seconds}) in {caller.f_code.co_name}(), line {caller.f_lineno} of "
            f"{caller.f_code.co_filename}, is skipped: in simulation time stands still while the mission's own code "
            "runs, so this pause is missing from the mission's time",
            RuntimeWarning,
            stacklevel=2,
        )


def _is_missions_code() -> bool:
    return threading.current_thread().name == _MISSION_THREAD and asyncio._get_running_loop() is None


_watch = _SleepWatch()


def sleeps_reported() -> contextlib.AbstractContextManager[None]:
    """In the block, `time.sleep` in a simulated mission warns with the caller's name, and returns at once."""
    return _watch.on()
