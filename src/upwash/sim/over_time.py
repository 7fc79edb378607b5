"""Measured numbers over the time of a flight."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from upwash.config.traces import Trace


class OverTime:
    """The numbers of a trace at a time since its first row: straight between the rows, constant after the last."""

    def __init__(self, trace: Trace) -> None:
        self._times_s = [row[0] - trace.rows[0][0] for row in trace.rows]
        self._rows = [row[1:] for row in trace.rows]

    def at(self, elapsed_s: float) -> Sequence[float]:
        """The numbers at that time."""
        after = bisect_right(self._times_s, elapsed_s)
        if not 0 < after < len(self._rows):
            return self._rows[0] if after == 0 else self._rows[-1]
        begins_s, ends_s = self._times_s[after - 1 : after + 1]
        share = (elapsed_s - begins_s) / (ends_s - begins_s)
        return [
            here + share * (there - here)
            for here, there in zip(self._rows[after - 1], self._rows[after], strict=True)
        ]
