"""Answers by a deadline with a probability: what servers can promise, and when a second server gets a call too.

A promise holds with a confidence of 95 %, for all distributions of the delays. Two servers are late independently
of each other: if a share q of the calls is late at each, q² is late at both. The second server gets only calls that
the first has not answered after `after_s`. This time is as long as the probability allows, so that the second server
computes fewest calls.

The promise of two servers takes three bounds, each with a third of the 5 %. They bound what the first answers in
time, what the first answers before `after_s`, and what the second answers in the time left. As `after_s` is chosen
from the same delays, it follows from a delay of a fixed rank. `extra` fixes the rank at the first server, the first
server's delays fix the rank at the second. The share of calls that is faster than the r-th of n delays has a known
distribution.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated

from msgspec import Meta, Struct

from upwash.core.operation import Operation
from upwash.core.selection.shares import calls_for, hits_for, least_share
from upwash.kinds import Positive, Share

MISS = 0.05  # the probability that a promise is too high
_BOUNDS = 3  # of two servers
_WINDOW_LENGTH = 3000  # delays; one server's 0.999 takes 2,995
_MOMENT_S = 0.05  # answers and timers may be later than known by it
Probability = Annotated[float, Meta(gt=0, lt=1, description="a number above 0 and below 1, such as 0.99")]


class AnswerDeadline(
    Struct, frozen=True, forbid_unknown_fields=True, rename={"within_s": "s", "probability": "p"}
):
    """By when a call is answered, and how surely: [deadlines](calls.md#deadlines)."""

    within_s: Positive
    """The time from the call to its answer, in seconds."""
    probability: Probability
    """The least probability of an answer in that time, such as 0.99; without it the flight is refused."""
    extra: Share = 0.1
    """The largest share of the calls that a second server may compute too."""

    def delays_needed(self, servers: int) -> int:
        """The fewest delays of each of one or two servers that show the probability, if all of them are in time."""
        if servers == 1:
            return calls_for(self.probability, MISS)
        each = max(1 - math.sqrt(1 - self.probability), 1 - self.extra)
        return calls_for(each, MISS / _BOUNDS)


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
        return self._in_time(within_s) / (self.known + 1)

    def least_share_by(self, within_s: float, miss: float) -> float:
        """The share of calls that is answered in that time is at least this, with the probability 1 - `miss`."""
        return least_share(self._in_time(within_s), self.known, miss)

    def reached_s(self, share: float, miss: float, *, within_s: float) -> float | None:
        """The time (s) until that share is answered, with the probability 1 - `miss`; None if that is later."""
        rank = hits_for(share, self.known, miss)
        return (self._sorted[rank - 1] if rank else 0.0) if rank <= self._in_time(within_s) else None

    def slowest_s(self, within_s: float) -> float:
        """The longest delay (s) within that time; 0 without one."""
        return max((delay_s for delay_s in self._latest if delay_s <= within_s), default=0.0)

    def _in_time(self, within_s: float) -> int:
        return bisect_right(self._sorted, within_s)


def prospect(
    deadline: AnswerDeadline, first: Delays, second: Delays | None, *, miss: float = MISS
) -> Prospect:
    """What the first server promises alone, or with the second one asked as late as the probability allows.

    The promise is too high with the probability `miss` at most.
    """
    within_s = deadline.within_s
    if second is None or not second.known:
        return Prospect(first.least_share_by(within_s, miss))
    miss /= _BOUNDS
    alone = first.least_share_by(within_s, miss)
    if alone >= deadline.probability:
        return Prospect(alone)
    spared_s = first.reached_s(1 - deadline.extra, miss, within_s=within_s)
    soonest_s = first.slowest_s(within_s) if spared_s is None else spared_s
    soonest_s += _MOMENT_S if soonest_s else 0.0
    needed = 1 - (1 - deadline.probability) / (1 - alone)
    takes_s = second.reached_s(needed, miss, within_s=within_s - soonest_s)
    after_s = soonest_s if takes_s is None else max(soonest_s, within_s - takes_s - _MOMENT_S)
    if not second.share_by(within_s - after_s):
        return Prospect(alone)
    if spared_s is None:  # `extra` may be used up before a late call
        both = alone
    elif takes_s is None:
        both = 1 - (1 - alone) * (1 - second.least_share_by(within_s - after_s, miss))
    else:
        both = deadline.probability
    return Prospect(both, min(deadline.extra, 1 - first.share_by(after_s)), after_s)


class Deadlines:
    """Plans the second servers of one drone's calls, and counts them.

    `known_s` has the delays of each operation at each server that were measured before the flight.
    """

    def __init__(
        self,
        deadlines: Mapping[Operation, AnswerDeadline] = MappingProxyType({}),
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
