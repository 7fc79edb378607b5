"""What the operating system's signals ask of a program that runs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator

_log = logging.getLogger("upwash.signals")

_SECOND_SIGNAL_S = 0.5  # a terminal and a parent may both pass on one Ctrl-C


@contextlib.contextmanager
def stopping_politely(stop: Callable[[str], None]) -> Iterator[None]:
    """The first SIGINT or SIGTERM asks to stop; the second cancels what runs."""
    loop = asyncio.get_running_loop()
    running = asyncio.current_task()
    asked_s: list[float] = []

    def on_signal(number: signal.Signals) -> None:
        now_s = loop.time()
        if not asked_s:
            stop("Ctrl-C" if number is signal.SIGINT else number.name)
        elif now_s - asked_s[0] > _SECOND_SIGNAL_S and running is not None:
            running.cancel()
        asked_s.append(now_s)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, on_signal, number)
    try:
        yield
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


@contextlib.contextmanager
def ending_in_time() -> Iterator[Callable[[float], None]]:
    """Yields what has the program ended after so many seconds, with exit code 1, where the block still hangs then."""
    timers: list[threading.Timer] = []

    def end() -> None:
        _log.error("what was under way did not end in time: ending without it")
        os._exit(1)

    def within(seconds: float) -> None:
        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        timers.append(timer)

    try:
        yield within
    finally:
        for timer in timers:
            timer.cancel()


@contextlib.contextmanager
def on_signal(number: signal.Signals, do: Callable[[], None]) -> Iterator[None]:
    """Does it each time that this signal comes."""
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(number, do)
    try:
        yield
    finally:
        loop.remove_signal_handler(number)


@contextlib.contextmanager
def outliving_the_terminal() -> Iterator[None]:
    """A terminal that is closed ends nothing; what is printed to it from then on is lost."""
    terminals = [handle for handle in (0, 1, 2) if os.isatty(handle)]

    def let_go() -> None:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for handle in terminals:
            os.dup2(nowhere, handle)
        os.close(nowhere)

    with on_signal(signal.SIGHUP, let_go):
        yield
