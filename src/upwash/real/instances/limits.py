"""What a service instance may use, put on it by itself: a module of its own, as its process has no use for more."""

from __future__ import annotations

import resource

from upwash.core.admission.limits import Limits

_MOST_FILES = 4096  # open at once: of 1024 connections, two ends of each and what gRPC adds
_NO_CORE = 1  # 0 would still have the kernel pipe one to whoever collects them


def apply_limits(limits: Limits) -> None:
    """Puts them on this process and all that it will start; nothing can lift them again.

    Processors are not among them: a process may choose others, unless it began with a filter of system calls.
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
    """Lets this process and all that it will start leave no core files, and open few files at a time."""
    resource.setrlimit(resource.RLIMIT_CORE, (_NO_CORE, _NO_CORE))
    most = min(_MOST_FILES, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
