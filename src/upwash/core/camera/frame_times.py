"""When the frames of a stream were captured, by when they arrive."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

_KEPT = 9  # intervals, so that a new rate counts after five frames
_FEWEST = 3
_LEAST_GAP_S = 0.25
_GAP = 3.0  # usual intervals
_PACE = 0.75


class FrameTimes:
    """Tells frames that a stalled stream kept back from new ones.

    After a gap, frames that arrive in less than three quarters of the usual interval are old: each was captured one
    usual interval after the frame before it. The first frame at the usual pace is new, and each frame when the burst
    has made up for the gap. A frame that is there at once may come from a buffer: the times of the stream then tell
    its age. A stream has `caught_up`, with the frames that came while it was opened, at the first frame that is not
    there at once.
    """

    def __init__(self) -> None:
        self._arrived_s: float | None = None
        self._intervals_s: deque[float] = deque(maxlen=_KEPT)
        self._late_s = 0.0
        self._ahead_s = math.inf  # the clock, of the stream's times, when the buffer was last empty
        self._stamp_s = 0.0
        self.caught_up = False

    def captured_s(self, arrived_s: float, *, waited_s: float = math.inf, stamp_s: float = 0.0) -> float:
        """When the frame that arrives now was captured, if a stream without stalls delivers at once.

        The reader waited `waited_s` for it; `stamp_s` is its time in the stream, 0 if unknown.
        """
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        ahead_s, known = arrived_s - stamp_s, self._arrived_s is not None
        if step_s <= 0 or waited_s >= _PACE * step_s:  # it was not in a buffer
            self._ahead_s = ahead_s
            self.caught_up |= known
        self._ahead_s = min(self._ahead_s, ahead_s)
        interval_s = 0.0 if self._arrived_s is None else arrived_s - self._arrived_s
        self._arrived_s = arrived_s
        if len(self._intervals_s) >= _FEWEST:
            usual_s = median(self._intervals_s)
            is_gap = interval_s > max(_GAP * usual_s, _LEAST_GAP_S)
            in_burst = self._late_s > 0 and interval_s < _PACE * usual_s
            if is_gap or in_burst:
                self._late_s = max(0.0, self._late_s + interval_s - usual_s)
            else:
                self._late_s = 0.0
            known = not in_burst
        if known:
            self._intervals_s.append(interval_s)
        return arrived_s - max(self._late_s, ahead_s - self._ahead_s)
