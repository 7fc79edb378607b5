"""How much of something is taken from whoever is not trusted with more."""

from __future__ import annotations


class Allowance:
    """So much a second, and `at_once` after a rest."""

    def __init__(self, per_s: float, *, at_once: float) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._left = at_once
        self._looked_s: float | None = None

    def take(self, amount: float, *, now_s: float) -> bool:
        """Takes that much where there is so much left; says whether it did."""
        self._refill(now_s)
        if amount > self._left:
            return False
        self._left -= amount
        return True

    def take_anyway_s(self, amount: float, *, now_s: float) -> float:
        """Takes that much; returns how long whoever wants more has to wait, in seconds."""
        self._refill(now_s)
        self._left -= amount
        return max(0.0, -self._left / self._per_s)

    def _refill(self, now_s: float) -> None:
        passed_s = now_s - self._looked_s if self._looked_s is not None else 0.0
        self._left = min(self._at_once, self._left + passed_s * self._per_s)
        self._looked_s = now_s
