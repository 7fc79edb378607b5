"""What a program has left of its computer, by the system itself."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

from upwash.real.host.computer import HostComputer

NOTHING_LEFT = """
import os, resource
from pathlib import Path
from upwash.real.host.computer import HostComputer

resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
computer, kept = HostComputer(Path()), []
before = computer.left()
try:
    while True:
        kept.append(os.open(os.devnull, os.O_RDONLY))
except OSError:
    now = computer.left()
print(before.files == len(kept), now.files, now.memory > 1e6, now.memory < before.memory * 2)
"""


def test_open_files_are_counted(tmp_path: Path) -> None:
    with contextlib.closing(HostComputer(tmp_path)) as computer:
        before = computer.left()
        opened = [os.open(os.devnull, os.O_RDONLY) for _ in range(7)]
        try:
            assert before.files - computer.left().files == 7
        finally:
            for file in opened:
                os.close(file)
        disk = os.statvfs(tmp_path)
        assert 0 < before.disk <= disk.f_blocks * disk.f_frsize
        assert before.memory > 0 and before.threads > 0


def test_a_program_without_files_to_open_still_learns_what_is_left() -> None:
    done = subprocess.run(
        [sys.executable, "-c", NOTHING_LEFT], capture_output=True, text=True, timeout=60.0, check=True
    )
    assert done.stdout == "True 0 True True\n"


def test_a_disk_that_is_gone_is_no_failure() -> None:
    with contextlib.closing(HostComputer(Path("/nowhere/at/all"))) as computer:
        assert computer.left().disk == float("inf")
