"""The limits of a service instance, which its own process sets on itself.

PROGRAM: `python -m upwash.real.instances.limits` tries each limit on itself, on one processor as an instance would,
and prints as JSON the names of the limits that do not hold.
"""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Callable

from upwash.core.admission.limits import Limits

_MOST_FILES = 4096  # open at once: two ends of each of 1024 connections, and gRPC's own
_NO_CORE = 1  # with 0 the kernel would still pipe a core dump to a program that collects them
_TRIED_BYTES = 2**20  # less memory than the interpreter has already


def apply_limits(limits: Limits) -> None:
    """Set the limits for good on this process and all that it will start.

    Processors are not among them: a process may choose others, unless a filter of system calls prevents it.
    """
    for number, most in (
        (resource.RLIMIT_DATA, limits.memory_bytes),
        (resource.RLIMIT_NPROC, limits.processes),
        (resource.RLIMIT_FSIZE, limits.disk_bytes),
    ):
        if most is not None:
            resource.setrlimit(number, (most, most))
    limit_files()


def limit_files() -> None:
    """Have this process and all that it will start write no core dumps, and open few files at a time."""
    resource.setrlimit(resource.RLIMIT_CORE, (_NO_CORE, _NO_CORE))
    most = min(_MOST_FILES, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def unenforced_limits() -> list[str]:
    """The names of the limits that can be exceeded; has the side effect that the others stay on this process."""
    import mmap  # instances, which import this module, need none of these
    import os
    import tempfile

    def write_too_much() -> None:
        with tempfile.TemporaryFile(buffering=0) as file:
            apply_limits(Limits(disk_bytes=_TRIED_BYTES))
            file.write(bytes(_TRIED_BYTES))
            file.write(b"!")

    def start_too_many() -> None:
        apply_limits(Limits(processes=1))
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)

    def leave_the_processor() -> None:
        if len(os.sched_getaffinity(0)) == 1:
            os.sched_setaffinity(0, os.sched_getaffinity(0))

    def take_too_much() -> None:
        apply_limits(Limits(memory_bytes=_TRIED_BYTES))
        mmap.mmap(-1, 16 * _TRIED_BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()

    attempts: dict[str, Callable[[], None]] = {
        "disk_bytes": write_too_much,
        "processes": start_too_many,
        "cpus": leave_the_processor,
        "memory_bytes": take_too_much,  # last: the others need memory
    }
    exceeded = []
    for name, attempt in attempts.items():
        with contextlib.suppress(OSError):
            attempt()
            exceeded.append(name)
    return exceeded


if __name__ == "__main__":
    import json

    print(json.dumps(unenforced_limits()))  # noqa: T201 - for the program that started this
