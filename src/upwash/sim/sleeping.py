"""Notices missions that sleep, which on virtual time waits for nothing."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from typing import SupportsIndex

_MISSION_THREAD = "mission"  # as mission.py names it


class _SleepWatch:
    """Stands in for `time.sleep` while any simulation of the process runs."""

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
        """Sleeps, but in a simulated mission: there it warns instead.

        A mission that imports the name while a simulation runs keeps this for good, so it looks each time.
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
    """Whether this is a mission's thread, and it runs no loop."""
    return threading.current_thread().name == _MISSION_THREAD and asyncio._get_running_loop() is None


_watch = _SleepWatch()


def sleeps_reported() -> contextlib.AbstractContextManager[None]:
    """While it is on, a simulated mission that calls `time.sleep` is warned by name, and goes on at once."""
    return _watch.on()
