"""How much memory the processes below this one have needed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

_PROCESSES = Path("/proc")


def peak_memory_bytes() -> int:
    """The sum of what each running process that this one started, and those below, has needed at most."""
    return sum(_peak_bytes(process) for process in _descendants(os.getpid()))


def _descendants(process: int) -> Iterator[int]:
    for thread in (_PROCESSES / str(process) / "task").glob("*"):
        for child in _read(thread / "children").split():
            yield int(child)
            yield from _descendants(int(child))


def _peak_bytes(process: int) -> int:
    for line in _read(_PROCESSES / str(process) / "status").splitlines():
        name, _, value = line.partition(":")
        if name == "VmHWM":
            return int(value.removesuffix(" kB")) * 1024
    return 0


def _read(file: Path) -> str:
    try:
        return file.read_text()
    except (FileNotFoundError, ProcessLookupError):  # it has ended since it was listed
        return ""
