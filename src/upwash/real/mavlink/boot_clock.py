"""A vehicle's own clock, by the time since boot in its messages: how it goes on, and that it was started anew."""

from __future__ import annotations

import math

_LATE_S = 1.0  # what is older by no more arrived out of order
_CONFIRMED_AFTER_S = 1.0  # of a second vehicle with one identity, and of a lie, the first is heard between
_PAUSE_S = 0.5  # after which no late message comes, and no second vehicle was there
_AHEAD_S, _FASTEST = 5.0, 20.0  # a simulated vehicle's clock may be faster than this computer's


class BootClock:
    """Feed it each time since boot. `elapsed_s` never goes back, whatever the vehicle says."""

    def __init__(self) -> None:
        self.elapsed_s = 0.0
        self.boot_s = -math.inf
        self._heard_s = -math.inf
        self._restarted_s: float | None = None  # when a smaller time was first heard that may be of a restart
        self._leapt_s: float | None = None  # when one was first heard that is too far ahead

    def take(self, boot_s: float, now_s: float) -> bool:
        """Takes in a time that was heard now; whether the vehicle has restarted."""
        step_s, passed_s = boot_s - self.boot_s, now_s - self._heard_s
        first, self._heard_s = math.isinf(self.boot_s), now_s
        if first:
            self.boot_s = boot_s
            return False
        if step_s < -_LATE_S:
            return self._goes_back(boot_s, now_s, passed_s)
        self._restarted_s = None
        if step_s > _AHEAD_S + _FASTEST * passed_s:
            self._leaps(boot_s, now_s, passed_s)
            return False
        self._leapt_s = None
        self.elapsed_s += max(0.0, step_s)
        self.boot_s = max(boot_s, self.boot_s)
        return False

    def _leaps(self, boot_s: float, now_s: float, passed_s: float) -> None:
        """Believes it where no other time comes between: from one lie on, all true times would be a restart's."""
        self.elapsed_s += passed_s
        if self._leapt_s is None:
            self._leapt_s = now_s
        if now_s - self._leapt_s >= _CONFIRMED_AFTER_S:
            self.boot_s, self._leapt_s = boot_s, None

    def _goes_back(self, boot_s: float, now_s: float, passed_s: float) -> bool:
        self.elapsed_s += passed_s
        if self._restarted_s is None:
            self._restarted_s = now_s
        if passed_s < _PAUSE_S and now_s - self._restarted_s < _CONFIRMED_AFTER_S:
            return False
        self.boot_s, self._restarted_s = boot_s, None
        return True
