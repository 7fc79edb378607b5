"""How much memory processes need, and how little of it a daemon may waste."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

_PROCESSES = Path("/proc")
_M_ARENA_MAX = -8  # glibc's name for it, in malloc.h


def keep_heaps_few() -> None:
    """Has the threads of this process share two heaps, where its C library can be told so.

    With one for each thread what many connections leave behind is scattered, and twice as much.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


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
