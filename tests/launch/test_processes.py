"""upwash's own commands as processes beside another."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from tests.waiting import wait_for

STARTER = """
import sys, time
from pathlib import Path
from upwash.launch.processes import ready_program

with ready_program("vehicle", Path(sys.argv[1]), "vehicle", "--listen", "tcp:127.0.0.1:0") as address:
    print(address, flush=True)
    time.sleep(60.0)
"""


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv of util-linux is not installed")
def test_a_program_ends_when_who_started_it_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", STARTER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        _, host, port = starter.stdout.readline().strip().split(":")
        assert answers(host, int(port))
        starter.kill()
    wait_for(lambda: not answers(host, int(port)), within_s=20.0)


def answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=5.0).close()
    except ConnectionError:
        return False
    return True
