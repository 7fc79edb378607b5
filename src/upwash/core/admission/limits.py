"""What an instance of a service may use, and a rate limit for untrusted clients."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The most that an instance may use; None means no limit.

    In a sandbox `memory_bytes` limits each process. `processes` counts threads too, `cpus` processors, and
    `disk_bytes` the files that the instance writes.
    """

    memory_bytes: int | None = None
    processes: int | None = None
    disk_bytes: int | None = None
    cpus: int | None = None


NO_LIMITS = Limits()
DEFAULT_LIMITS = Limits(memory_bytes=2**31, processes=256, disk_bytes=2**28)
CUDA_MEMORY_BYTES = 2**32  # by default with a graphics card: CUDA and cuDNN alone reserve half of it


class Allowance:
    """A rate limit: `per_s` a second on average, and `at_once` after a rest."""

    def __init__(self, per_s: float, *, at_once: float) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._left = at_once
        self._looked_s: float | None = None

    def take(self, amount: float, *, now_s: float) -> bool:
        """Take the amount if it is left; return whether it was."""
        self._refill(now_s)
        if amount > self._left:
            return False
        self._left -= amount
        return True

    def take_anyway_s(self, amount: float, *, now_s: float) -> float:
        """Take the amount in any case; return for how many seconds nothing more may be taken."""
        self._refill(now_s)
        self._left -= amount
        return max(0.0, -self._left / self._per_s)

    def _refill(self, now_s: float) -> None:
        passed_s = now_s - self._looked_s if self._looked_s is not None else 0.0
        self._left = min(self._at_once, self._left + passed_s * self._per_s)
        self._looked_s = now_s
