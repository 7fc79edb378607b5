"""PROGRAM: tries each limit of an instance on itself, and prints as JSON the names of those that do not hold.

It runs as an instance would, on one processor. The limits that hold stay on it for good.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import sys
import tempfile
from collections.abc import Callable

from upwash.core.admission.limits import Limits
from upwash.real.instances.limits import apply_limits

_TRIED_BYTES = 2**20  # less memory than the interpreter has already


def unenforced_limits() -> list[str]:
    """The names of the limits that can be exceeded."""
    return [name for name, exceed in _EXCEEDING.items() if _succeeds(exceed)]


def _succeeds(exceed: Callable[[], None]) -> bool:
    with contextlib.suppress(OSError):
        exceed()
        return True
    return False


def _write_too_much() -> None:
    with tempfile.TemporaryFile(buffering=0) as file:
        apply_limits(Limits(disk_bytes=_TRIED_BYTES))
        file.write(bytes(_TRIED_BYTES))
        file.write(b"!")


def _start_too_many() -> None:
    apply_limits(Limits(processes=1))
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def _leave_the_processor() -> None:
    if len(os.sched_getaffinity(0)) == 1:
        os.sched_setaffinity(0, os.sched_getaffinity(0))


def _take_too_much() -> None:
    apply_limits(Limits(memory_bytes=_TRIED_BYTES))
    mmap.mmap(-1, 16 * _TRIED_BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()


_EXCEEDING: dict[str, Callable[[], None]] = {
    "disk_bytes": _write_too_much,
    "processes": _start_too_many,
    "cpus": _leave_the_processor,
    "memory_bytes": _take_too_much,  # last: the others need memory
}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(unenforced_limits()))
