"""When the drone's own service starts on a call that a server has not answered yet, and how much it may compute so.

Extra work is what the drone computes for a call that the server answers within the ordinary deadline: without hedging
it would not have. Where the server answers later or not at all, the drone would have had to compute anyway.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Collection
from typing import Annotated

from msgspec import Meta, Struct

from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import Operation
from upwash.core.policies.policy import Remote
from upwash.kinds import Share

_WINDOW_LENGTH = 100  # delays; 19 are needed to tell a p95, 99 a p99
_EXCEEDS_BY_S = 0.001  # or calls that all take equally long would each be hedged as they are answered
_FEW = 2.0  # times the longest delay known stands in for a quantile that so few cannot tell
Quantile = Annotated[
    str, Meta(pattern=r"^p[1-9][0-9]?\Z", description='a quantile from "p1" to "p99", such as "p95"')
]


class HedgeRule(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When the drone's own service starts on a remote call that is late, and the share of extra work it may do."""

    after: Quantile = "p95"
    """The quantile of a server's delays; a longer call counts as late."""
    budget: Share = 0.1
    """The largest share of the drone's computing time that hedging may add."""

    @property
    def quantile(self) -> float:
        """`after` as a fraction."""
        return int(self.after[1:]) / 100


class Hedge(Struct, frozen=True):
    """The drone's own service starts `after_s` into a remote call; the server may answer until `deadline_s`."""

    after_s: float
    deadline_s: float


def quantile_s(delays_s: Collection[float], quantile: float, *, offline_s: float) -> float:
    """The delay (s) that a call exceeds with probability `1 - quantile` at most.

    With too few delays to tell, it is twice the longest of them and of `offline_s`, the estimate before any call.
    """
    rank = math.ceil(quantile * (len(delays_s) + 1))
    if rank > len(delays_s):
        return _FEW * max((offline_s, *delays_s))
    return sorted(delays_s)[rank - 1]


class Hedging:
    """Plan the hedges of one drone, within its budget of extra work; without a rule it hedges no call."""

    def __init__(self, estimates: Estimates, rule: HedgeRule | None = None) -> None:
        self._estimates = estimates
        self._rule = rule
        # The latest, of each operation on each server.
        self._delays_s: dict[tuple[str, Operation], deque[float]] = defaultdict(
            lambda: deque(maxlen=_WINDOW_LENGTH)
        )
        self._calls_s = 0.0  # the time of all calls, if computed on the drone
        self._extra_s = 0.0

    def called(self, operation: Operation) -> None:
        """Note that a call begins: the budget grows by a share of its time on the drone."""
        self._calls_s += self._estimates.local_s(operation) or 0.0

    def plan(
        self, decision: Remote, operation: Operation, *, is_busy: bool, within_s: float | None = None
    ) -> Hedge | None:
        """The hedge of a remote call; None if an earlier loser keeps the drone busy, or the budget is used up.

        The server may take as long as the drone is expected to: after that its answer is of no use. A call that the
        drone can answer `within_s` is hedged in time for that.
        """
        local_s = self._estimates.local_s(operation)
        if self._rule is None or is_busy or local_s is None:
            return None
        if self._extra_s >= self._rule.budget * self._calls_s:
            return None
        server, deadline_s = decision.server, decision.deadline_s
        offline_s = self._estimates.offline_s(server, operation) or 0.0
        late_s = quantile_s(self._delays_s[server, operation], self._rule.quantile, offline_s=offline_s)
        if decision.inputs.sends_less:
            late_s = self._estimates.as_less_s(server, operation, late_s)
        after_s = min(late_s + _EXCEEDS_BY_S, deadline_s)
        if within_s is not None and local_s <= within_s:
            after_s = min(after_s, within_s - local_s)
        return Hedge(after_s, max(deadline_s, after_s + local_s))

    def answered(self, server: str, operation: Operation, delay_s: float, *, less: bool = False) -> None:
        """Add the delay of a remote call that was answered; with `less` its request was made smaller before."""
        if less:
            delay_s = self._estimates.as_whole_s(server, operation, delay_s)
        self._delays_s[server, operation].append(delay_s)

    def overtaken(self, hedge: Hedge, decision: Remote, operation: Operation, *, onboard_s: float) -> None:
        """Note that the server answered first, `onboard_s` after the drone began.

        Within the usual deadline the drone's work was extra, and counts against the budget.
        """
        if hedge.after_s + onboard_s <= decision.deadline_s:
            self._extra_s += self._estimates.local_s(operation) or 0.0
