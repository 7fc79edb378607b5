"""What a service instance may use, put on it by itself: a module of its own, as its process has no use for more."""

from __future__ import annotations

import resource

import msgspec

_MOST_FILES = 4096  # open at once: of 1024 connections, two ends of each and what gRPC adds
_NO_CORE = 1  # 0 would still have the kernel pipe one to whoever collects them


class Limits(msgspec.Struct, frozen=True):
    """What an instance may use: memory for each of its processes, so many of them and their threads, files."""

    memory_bytes: int
    processes: int
    disk_bytes: int

    def apply(self) -> None:
        """Puts them on this process and all that it will start; nothing can lift them again."""
        resource.setrlimit(resource.RLIMIT_DATA, (self.memory_bytes, self.memory_bytes))
        resource.setrlimit(resource.RLIMIT_NPROC, (self.processes, self.processes))
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.disk_bytes, self.disk_bytes))
        limit_files()


def limit_files() -> None:
    """Lets this process and all that it will start leave no core files, and open few files at a time."""
    resource.setrlimit(resource.RLIMIT_CORE, (_NO_CORE, _NO_CORE))
    most = min(_MOST_FILES, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
