"""What an instance of a service may use."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The most that an instance may use; None where no limit holds.

    Of a process in a sandbox, `memory_bytes` holds for each of its processes. `processes` counts threads too, `cpus`
    processors, and `disk_bytes` the files that it writes.
    """

    memory_bytes: int | None = None
    processes: int | None = None
    disk_bytes: int | None = None
    cpus: int | None = None


NO_LIMITS = Limits()
DEFAULT_LIMITS = Limits(memory_bytes=2**31, processes=256, disk_bytes=2**28)
