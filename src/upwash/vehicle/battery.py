"""A stand-in ArduCopter's battery."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Battery:
    """How full it is, from how long the motors have run."""

    percent: float
    drain_percent_s: float
    draining_since_s: float | None = None

    def left_percent(self, now_s: float) -> float:
        """How full it is."""
        used_s = 0.0 if self.draining_since_s is None else now_s - self.draining_since_s
        return max(0.0, self.percent - used_s * self.drain_percent_s)

    def stop(self, now_s: float) -> None:
        """The motors draw nothing more."""
        self.percent = self.left_percent(now_s)
        self.draining_since_s = None
