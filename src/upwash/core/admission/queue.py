"""The calls at one instance: which are computed, which wait, and how many seconds of work a new call has before it.

Calls begin in the order of their arrival, as many at a time as the instance has lanes. A call is expected to take as
long as the latest calls did. A call that has taken longer is expected to take as much longer again.
"""

from __future__ import annotations

import heapq
from collections import deque
from statistics import fmean

from upwash.errors import NotBegun

_LATEST = 3  # calls whose mean time is expected of the next


class CallQueue:
    """Follows the calls at an instance that computes `lanes` calls at a time; `arrive` gives each call its number."""

    def __init__(self, lanes: int) -> None:
        self._lanes = lanes
        self._calls = 0  # that have arrived
        self._waiting: set[int] = set()
        self._begun_s: dict[int, float] = {}
        self._latest_s = deque[float](maxlen=_LATEST)

    def arrive(self, may_queue_s: float | None, *, now_s: float) -> int:
        """Let a call wait; raises NotBegun if it would not begin within `may_queue_s`, None for any time."""
        if may_queue_s is not None and (ahead_s := self.ahead_s(now_s=now_s)) > may_queue_s:
            raise NotBegun(ahead_s)
        self._calls += 1
        self._waiting.add(self._calls)
        return self._calls

    def begin(self, call: int, *, now_s: float) -> None:
        """Note that the call is computed from now on."""
        self._waiting.discard(call)
        self._begun_s[call] = now_s

    def end(self, call: int, *, now_s: float) -> None:
        """Note that the call is computed, which shows how long calls take."""
        self._latest_s.append(now_s - self._begun_s[call])
        self.leave(call)

    def leave(self, call: int) -> None:
        """Note that the call is here no more."""
        self._waiting.discard(call)
        self._begun_s.pop(call, None)

    def ahead_s(self, *, now_s: float) -> float:
        """The seconds until a call that arrives now begins; 0 while no call has shown how long calls take."""
        if not self._latest_s or len(self._begun_s) + len(self._waiting) < self._lanes:
            return 0.0
        call_s = fmean(self._latest_s)
        free_in_s = [abs(call_s - (now_s - begun_s)) for begun_s in self._begun_s.values()]
        free_in_s += [0.0] * (self._lanes - len(free_in_s))
        heapq.heapify(free_in_s)
        for _ in self._waiting:
            heapq.heapreplace(free_in_s, free_in_s[0] + call_s)
        return free_in_s[0]
