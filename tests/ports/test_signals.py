"""What a program that is told to end does with what hangs."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys

import pytest

from upwash.real.host.signals import stopping_politely

HANGING = """
import threading
from upwash.real.host.signals import ending_in_time

with ending_in_time() as within:
    within({seconds})
    {hang}
print("ended by itself")
"""


def run(*, seconds: float, hang: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", HANGING.format(seconds=seconds, hang=hang)],
        capture_output=True,
        text=True,
        timeout=30.0,
        check=False,
    )


def test_what_hangs_is_left_after_its_time() -> None:
    done = run(seconds=0.1, hang="threading.Event().wait()")
    assert (done.returncode, done.stdout) == (1, "")
    assert "did not end in time" in done.stderr


def test_what_ends_in_time_is_left_alone() -> None:
    done = run(seconds=20.0, hang="pass")
    assert (done.returncode, done.stdout) == (0, "ended by itself\n")


@pytest.mark.parametrize(("is_stopping", "asked"), [(False, ["Ctrl-C"]), (True, [])])
def test_the_first_ctrl_c_asks_to_stop_and_ends_at_once_what_is_stopping_already(
    is_stopping: bool, asked: list[str]
) -> None:
    said = list[str]()

    def stop(why: str) -> bool:
        if not is_stopping:
            said.append(why)
        return not is_stopping

    async def run() -> None:
        with stopping_politely(stop):
            os.kill(os.getpid(), signal.SIGINT)
            await asyncio.sleep(0.2)

    if is_stopping:
        with pytest.raises(asyncio.CancelledError):
            asyncio.run(run())
    else:
        asyncio.run(run())
    assert said == asked


@pytest.mark.parametrize(
    "number", [signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGIO, signal.SIGRTMAX]
)
def test_a_signal_that_would_kill_asks_to_stop_once_and_ends_nothing_at_once(number: int) -> None:
    said = list[str]()

    async def run() -> None:
        with stopping_politely(said.append):
            for pause_s in (0.6, 0.05):
                os.kill(os.getpid(), number)
                await asyncio.sleep(pause_s)
        assert signal.getsignal(number) is signal.SIG_DFL

    asyncio.run(run())
    assert said == [signal.Signals(number).name]
