"""The operating system's signals to a program."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator

from upwash.support.text import signal_name

_log = logging.getLogger("upwash.signals")

_KILL = (
    "SIGQUIT",
    "SIGUSR1",
    "SIGUSR2",
    "SIGALRM",
    "SIGVTALRM",
    "SIGPROF",
    "SIGXCPU",
    "SIGIO",
    "SIGPWR",
    "SIGSTKFLT",
)
_SECOND_SIGNAL_S = 0.5  # a terminal and a parent may both pass on one Ctrl-C


@contextlib.contextmanager
def on_signal(number: int, do: Callable[[], object]) -> Iterator[None]:
    """Calls `do` at each signal of that number, until the end of the block."""
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(number, do)
    try:
        yield
    finally:
        loop.remove_signal_handler(number)


@contextlib.contextmanager
def stopping_politely(stop: Callable[[str], bool | None]) -> Iterator[None]:
    """In the block, the first signal that asks the program to end calls `stop` with the signal's name.

    A second SIGINT or SIGTERM cancels the current task. If `stop` returns False, the task is being stopped already,
    and the first of these signals cancels it. Other signals that would kill the program only call `stop`.
    """
    loop = asyncio.get_running_loop()
    running = asyncio.current_task()
    asked_s: list[float] = []

    def ask(name: str, *, cancels: bool) -> None:
        now_s = loop.time()
        is_over = bool(asked_s) and now_s - asked_s[0] > _SECOND_SIGNAL_S
        if not asked_s:
            is_over = stop(name) is False
        if is_over and cancels and running is not None:
            running.cancel()
        asked_s.append(now_s)

    with contextlib.ExitStack() as stack:
        for number in _others_that_kill():
            asked = functools.partial(ask, signal_name(number), cancels=False)
            stack.enter_context(on_signal(number, asked))
        for number, name in ((signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM")):
            stack.enter_context(on_signal(number, functools.partial(ask, name, cancels=True)))
        yield


def _others_that_kill() -> Iterator[int]:
    """The signals besides SIGINT, SIGTERM and SIGHUP that end the program now, and that tell of no fault in it."""
    real_time = range(signal.SIGRTMIN, signal.SIGRTMAX + 1) if hasattr(signal, "SIGRTMIN") else ()
    known = [getattr(signal, name) for name in _KILL if hasattr(signal, name)]
    return (number for number in (*known, *real_time) if signal.getsignal(number) is signal.SIG_DFL)


@contextlib.contextmanager
def ending_in_time() -> Iterator[Callable[[float], None]]:
    """Yields a function of seconds: after them the program ends, with exit code 1, if the block still runs."""

    def end() -> None:
        _log.error("what was under way did not end in time: ending without it")
        os._exit(1)

    with contextlib.ExitStack() as stack:

        def within(seconds: float) -> None:
            timer = threading.Timer(seconds, end)
            timer.daemon = True
            timer.start()
            stack.callback(timer.cancel)

        yield within


@contextlib.contextmanager
def outliving_the_terminal() -> Iterator[None]:
    """In the block, a closed terminal does not end the program; output to it is lost from then on."""
    terminals = [handle for handle in (0, 1, 2) if os.isatty(handle)]

    def let_go() -> None:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for handle in terminals:
            os.dup2(nowhere, handle)
        os.close(nowhere)

    with on_signal(signal.SIGHUP, let_go):
        yield
