"""Which processes run, and what a test left running, or as a zombie, of the instances that it started."""

from __future__ import annotations

import os
from pathlib import Path


def expect_no_child() -> None:
    """Neither an instance nor a zombie is a child of this process; others may be, as other tests start pools."""
    assert [child for child in _children() if _is_left_over(child)] == []


def is_alive(process_id: int) -> bool:
    """Whether it runs: neither gone nor a zombie."""
    return _stat(Path("/proc", str(process_id)))[:1] not in ([], ["Z"], ["X"])


def _children() -> list[Path]:
    return [
        entry
        for entry in Path("/proc").iterdir()
        if entry.name.isdigit() and _stat(entry)[1:2] == [str(os.getpid())]
    ]


def _is_left_over(process: Path) -> bool:
    try:
        return (
            _stat(process)[0] == "Z"
            or b"upwash.real.instances.instance" in (process / "cmdline").read_bytes()
        )
    except (OSError, IndexError):
        return False


def _stat(process: Path) -> list[str]:
    """State, parent and so on; empty for a process that has just ended."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []
