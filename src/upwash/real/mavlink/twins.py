"""Whether two vehicles speak with one system id."""

from __future__ import annotations

from collections import deque

from upwash.real.mavlink.hearing import Message

_LATE_S = 2.0  # no message comes later
_TIMES, _WITHIN_S = 3, 10.0  # one vehicle restarts too, but less often


class Twins:
    """What tells two vehicles apart that have the same ids: their clocks since boot, and their hardware."""

    def __init__(self) -> None:
        self.evidence = ""  # empty while there is none
        self._first: dict[
            int, tuple[int, float]
        ] = {}  # by message number: time since boot, and when it was heard
        self._boot_ms: dict[int, int] = {}  # the last time since boot, by message number
        self._went_back_s: dict[int, deque[float]] = {}  # by message number: a restart shows once in each
        self._hardware: set[tuple[int, bytes]] = set()

    def take(self, message: Message, now_s: float) -> None:
        """Takes in a message with the ids in question, as it came."""
        if (boot_ms := getattr(message, "time_boot_ms", None)) is not None:
            self._take_clock(message.get_msgId(), boot_ms, now_s)
        elif message.get_type() == "AUTOPILOT_VERSION" and len(self._hardware) < 2:
            self._hardware.add((message.uid, bytes(message.uid2)))
            if len(self._hardware) > 1:
                self.evidence = "two serial numbers of hardware"

    def _take_clock(self, number: int, boot_ms: int, now_s: float) -> None:
        first_ms, first_s = self._first.setdefault(number, (boot_ms, now_s))
        before_ms = self._boot_ms.get(number, boot_ms)
        self._boot_ms[number] = boot_ms
        # A simulated vehicle's clock may be fast, and what comes late is then late by more of its time.
        fastness = max(1.0, (before_ms - first_ms) / 1000.0 / max(now_s - first_s, 1.0))
        if boot_ms < before_ms - 1000.0 * _LATE_S * fastness:
            times_s = self._went_back_s.setdefault(number, deque(maxlen=_TIMES))
            times_s.append(now_s)
            if len(times_s) == _TIMES and now_s - times_s[0] <= _WITHIN_S:
                self.evidence = "two clocks since boot"
