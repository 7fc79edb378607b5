"""Answers by a deadline with a probability: what servers can promise, and when a second server gets a call too.

Two servers are late independently of each other: if a share q of the calls is late at each, q² is late at both. The
second server gets only calls that the first has not answered after `after_s`. This time is as long as the probability
allows, so that the second server computes fewest calls.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from msgspec import Struct

from upwash.core.operation import Operation

_WINDOW_LENGTH = 1000  # delays
_MOMENT_S = 0.05  # answers and timers may be later than known by it


class Deadline(Struct, frozen=True):
    """Calls are answered within `within_s` with the `probability`; a second server gets the share `extra` at most."""

    within_s: float
    probability: float
    extra: float


class Prospect(Struct, frozen=True):
    """The probability of an answer in time, and the share of calls that a second server gets, `after_s` each."""

    probability: float
    extra: float = 0.0
    after_s: float | None = None


class Delays:
    """The latest delays (s) of one operation at one server; a call without an answer has an endless one."""

    def __init__(self, known_s: Iterable[float] = ()) -> None:
        self._latest = deque(known_s, maxlen=_WINDOW_LENGTH)
        self._sorted = sorted(self._latest)

    @property
    def known(self) -> int:
        """How many delays are known."""
        return len(self._latest)

    def add(self, delay_s: float) -> None:
        """Adds the delay of a call."""
        if len(self._latest) == _WINDOW_LENGTH:
            self._sorted.remove(self._latest[0])
        self._latest.append(delay_s)
        insort(self._sorted, delay_s)

    def share_by(self, within_s: float) -> float:
        """The share of calls that is answered in that time; never 1, as the next call may be the slowest."""
        return bisect_right(self._sorted, within_s) / (len(self._sorted) + 1)

    def reached_s(self, share: float, *, within_s: float) -> float | None:
        """The time (s) until that share of the calls is answered, or their most `within_s`; None without a call."""
        in_time = bisect_right(self._sorted, within_s)
        rank = min(math.ceil(share * (len(self._sorted) + 1)), in_time)
        return self._sorted[rank - 1] if rank > 0 else None


def prospect(deadline: Deadline, first: Delays, second: Delays | None) -> Prospect:
    """What the first server promises alone, or with the second one asked as late as the probability allows."""
    within_s = deadline.within_s
    alone = first.share_by(within_s)
    if alone >= deadline.probability or second is None:
        return Prospect(alone)
    needed = 1 - (1 - deadline.probability) / (1 - alone)
    takes_s = second.reached_s(needed, within_s=within_s)
    if takes_s is None:
        return Prospect(alone)
    after_s = max(0.0, within_s - takes_s - _MOMENT_S)
    spared_s = first.reached_s(1 - deadline.extra, within_s=within_s)
    if 1 - first.share_by(after_s) > deadline.extra and spared_s is not None:
        after_s = spared_s + _MOMENT_S
        takes_s = within_s - after_s
        if not second.share_by(takes_s):
            return Prospect(alone)
    late = 1 - first.share_by(after_s)
    helped = min(1.0, deadline.extra / late)  # of the late calls
    both = 1 - (1 - alone) * (1 - helped * second.share_by(takes_s))
    return Prospect(both, helped * late, after_s)


class Deadlines:
    """Plans the second servers of one drone's calls, and counts them.

    `known_s` has the delays of each operation at each server that were measured before the flight.
    """

    def __init__(
        self,
        deadlines: Mapping[Operation, Deadline] = MappingProxyType({}),
        known_s: Mapping[tuple[str, Operation], Sequence[float]] = MappingProxyType({}),
    ) -> None:
        self._deadlines = deadlines
        self._delays = {place: Delays(known_s[place]) for place in known_s}
        self._calls = Counter[Operation]()
        self._second = Counter[Operation]()

    def within_s(self, operation: Operation) -> float | None:
        """The deadline (s) of its calls; None without one."""
        deadline = self._deadlines.get(operation)
        return None if deadline is None else deadline.within_s

    def called(self, operation: Operation) -> None:
        """Note that a call begins."""
        self._calls[operation] += 1

    def answered(self, server: str, operation: Operation, delay_s: float) -> None:
        """Note the delay of a call at a server, which is endless where no answer came."""
        if operation in self._deadlines:
            self._delays.setdefault((server, operation), Delays()).add(delay_s)

    def prospect(self, operation: Operation, first: str, second: str | None) -> Prospect | None:
        """What these servers promise now; None for an operation without a deadline."""
        deadline = self._deadlines.get(operation)
        if deadline is None:
            return None
        beside = self._delays.get((second, operation), Delays()) if second is not None else None
        return prospect(deadline, self._delays.get((first, operation), Delays()), beside)

    def may_ask(self, operation: Operation) -> bool:
        """Whether a second server may get a call: one, and then the allowed share of those made."""
        return self._second[operation] <= self._deadlines[operation].extra * self._calls[operation]

    def asked(self, operation: Operation) -> None:
        """Note that a second server gets a call."""
        self._second[operation] += 1
