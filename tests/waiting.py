"""Waiting in tests for what another thread, process or machine does, and how fast this machine is meanwhile."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")
_LOOK_S = 0.02


def wait_for(
    look: Callable[[], T],
    *,
    within_s: float = 30.0,
    process: subprocess.Popen[Any] | None = None,
    seen: Callable[[], object] = lambda: "",
) -> T:
    """What `look` returns, once that is true; fails after that time, or where the process ends first.

    What was `seen` instead is in the failure.
    """
    give_up_s = time.monotonic() + within_s
    while not (found := look()):
        assert process is None or process.poll() is None, f"it ended too early: {seen()}"
        assert time.monotonic() < give_up_s, f"not within {within_s:g} s: {seen()}"
        time.sleep(_LOOK_S)
    return found


def million_steps_s() -> float:
    """The processor time that a loop of a million steps takes now, on this machine, beside what else runs."""
    began_s = time.process_time()
    for _ in range(1_000_000):
        pass
    return time.process_time() - began_s
