"""The first process of a container: it reaps orphans, passes signals on, and ends as the program does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.children import processes
from tests.waiting import wait_for

PROGRAM = """
import ctypes, os, signal, subprocess
from upwash.real.host.first_process import go_on_in_child

PR_SET_CHILD_SUBREAPER = 36  # orphans below become children of this process, as of process 1
ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
go_on_in_child()
own = subprocess.Popen(["sh", "-c", "exit 7"])
orphan = subprocess.run(["sh", "-c", "sleep 600 >/dev/null & echo $!"], stdout=subprocess.PIPE, text=True)
signal.signal(signal.SIGHUP, lambda *_: os._exit(own.wait()))
print(orphan.stdout, end="", flush=True)
while True:
    signal.pause()
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGHUP, 7), (signal.SIGTERM, 128 + signal.SIGTERM)])
def test_orphans_are_reaped_and_the_program_keeps_its_own_children(number: signal.Signals, code: int) -> None:
    with subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        orphan = int(first.stdout.readline())
        wait_for(lambda: orphan in [each.pid for each in processes() if each.parent == first.pid])
        os.kill(orphan, signal.SIGKILL)
        wait_for(lambda: not Path(f"/proc/{orphan}").exists())
        first.send_signal(number)
        assert first.wait(timeout=10.0) == code
