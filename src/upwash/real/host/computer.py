"""What this program has left of its computer: open files, threads, memory, and the disk of its log.

All that it reads is opened at the beginning: later there may be no file to spare for a look. Of groups of control it
knows those of version 2.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import re
import resource
from pathlib import Path

from upwash.core.knowledge.supplies import Supplies

_LOOK_S = 1.0
_MOST_FILES = 65_536  # more take long to count
_LONGEST_BYTES = 8192
_KIB = 1024


class HostComputer:
    """The computer that this program runs on, until it is closed; `disk` is a folder of the disk that counts."""

    def __init__(self, disk: Path) -> None:
        process, group = Path("/proc/self"), _group()
        self._disk = disk
        self._status, self._meminfo = _Readings(process / "status"), _Readings(Path("/proc/meminfo"))
        self._group = {
            name: _Readings(group / name)
            for name in ("pids.max", "pids.current", "memory.max", "memory.current", "memory.stat")
        }

    def left(self) -> Supplies:
        """What is left now; infinite where the system does not tell."""
        return Supplies(_files_left(), self._threads_left(), self._memory_left(), self._disk_left())

    async def may_have_changed(self) -> None:
        """Return after a second."""
        await asyncio.sleep(_LOOK_S)

    def close(self) -> None:
        """Close the files that tell."""
        for readings in (self._status, self._meminfo, *self._group.values()):
            readings.close()

    def _threads_left(self) -> float:
        own = math.inf  # root has no limit of its own
        if os.geteuid():
            own = _limit(resource.RLIMIT_NPROC) - self._status.number("Threads:", otherwise=0)
        return min(own, self._group["pids.max"].number() - self._group["pids.current"].number(otherwise=0))

    def _memory_left(self) -> float:
        free = self._meminfo.number("MemAvailable:") + self._meminfo.number("SwapFree:", otherwise=0)
        own = _limit(resource.RLIMIT_AS) - _KIB * self._status.number("VmSize:", otherwise=0)
        cached = self._group["memory.stat"].number("inactive_file ", otherwise=0)
        used = self._group["memory.current"].number(otherwise=0) - cached
        return min(_KIB * free, own, self._group["memory.max"].number() - used)

    def _disk_left(self) -> float:
        try:
            found = os.statvfs(self._disk)
        except OSError:
            return math.inf
        return float(found.f_bavail * found.f_frsize)


class _Readings:
    """A small file of the kernel, read again and again; without the file it has no numbers."""

    def __init__(self, path: Path) -> None:
        self._file: int | None = None
        with contextlib.suppress(OSError):
            self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)

    def number(self, name: str = "", *, otherwise: float = math.inf) -> float:
        """The first number behind the name at the beginning of a line; `otherwise` where none is there."""
        if self._file is None:
            return otherwise
        try:
            text = os.pread(self._file, _LONGEST_BYTES, 0).decode(errors="replace")
        except OSError:
            return otherwise
        found = re.search(rf"^{re.escape(name)}\s*(\d+)", text, re.MULTILINE)
        return float(found[1]) if found else otherwise

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


def with_many_files() -> None:
    """Let this program have as many open files as its hard limit allows, up to 65,536."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = min(_MOST_FILES, hard if hard != resource.RLIM_INFINITY else _MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < most:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _files_left() -> float:
    limit = _limit(resource.RLIMIT_NOFILE)
    for folder in ("/proc/self/fd", "/dev/fd"):
        try:
            return limit - len(os.listdir(folder)) + 1  # noqa: PTH208 - without the folder itself
        except FileNotFoundError:
            continue
        except OSError:  # no file is left for the look
            return 0
    return math.inf


def _limit(kind: int) -> float:
    soft, _ = resource.getrlimit(kind)
    return math.inf if soft == resource.RLIM_INFINITY else soft


def _group() -> Path:
    """The folder of this program's group of control, version 2; other systems have no such folder."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            if line.startswith("0::/"):
                return Path("/sys/fs/cgroup", line.removeprefix("0::/"))
    return Path("/nowhere")
