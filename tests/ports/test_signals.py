"""What a program that is told to end does with what hangs."""

from __future__ import annotations

import subprocess
import sys

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
