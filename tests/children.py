"""Which processes run, and what a test left running, or as a zombie, of the instances that it started."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Process:
    """A process of this machine, as proc(5) has it."""

    pid: int
    state: str
    parent: int
    command: str

    @property
    def is_instance(self) -> bool:
        return "upwash.real.instances.instance" in self.command


def processes(*, mark: str = "") -> Iterator[Process]:
    """Every process, or those that have the mark in their environment."""
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):  # it has just ended
            if entry.name.isdigit() and (not mark or mark.encode() in (entry / "environ").read_bytes()):
                state, parent = _stat(int(entry.name))[:2]
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                yield Process(int(entry.name), state, int(parent), command)


def children(process_id: int) -> list[int]:
    """The living processes that the process started."""
    return [
        process.pid for process in processes() if process.parent == process_id and process.state not in "ZX"
    ]


def descendants(process_id: int) -> set[int]:
    """The process, those that it started, and those that they started, in sandboxes and containers too."""
    parents = {process.pid: process.parent for process in processes()}
    found: set[int] = set()
    added = {process_id}
    while added:
        found |= added
        added = {child for child, parent in parents.items() if parent in added}
    return found


def expect_no_child() -> None:
    """Neither an instance nor a zombie is a child of this process; others may be, as other tests start pools."""
    own = [process for process in processes() if process.parent == os.getpid()]
    assert [each for each in own if each.state == "Z" or each.is_instance] == []


def is_alive(process_id: int) -> bool:
    """Whether it runs: neither gone nor a zombie."""
    try:
        return _stat(process_id)[0] not in "ZX"
    except OSError:
        return False


def gone(*process_ids: int) -> bool:
    """Whether all of these end within a few seconds."""
    give_up_s = time.monotonic() + 5.0
    while any(map(is_alive, process_ids)):
        if time.monotonic() > give_up_s:
            return False
        time.sleep(0.01)
    return True


def _stat(process_id: int) -> list[str]:
    """State, parent and so on."""
    return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
