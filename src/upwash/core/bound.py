"""How fast a mission can be at best, whoever decides: what is left to gain.

Both bounds know every true delay and never pay for the start of a service.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from upwash.core.schedule import CheckTimes, ComingCall, quickest


@dataclass(frozen=True, slots=True)
class Bound:
    """The least total delay of a mission's calls: with every server joined for nothing, and paying for each join."""

    free_s: float
    with_joins_s: float


def bound(calls: Sequence[ComingCall], joins_s: Mapping[str, float]) -> Bound:
    """The bounds for calls with their true delays, and servers with the true times of joining them.

    Each call runs where it is fastest. Paying for joins, there is one radio: the drone leaves one network to join
    another, on the way between two calls where it can, and each mission decides in hindsight.
    """
    free_s = sum(min([call.local_s, *(offer.call_s for offer in call.offers)]) for call in calls)
    joins = {server: CheckTimes(join_s, join_s) for server, join_s in joins_s.items()}
    return Bound(free_s, quickest(calls, joins).total_s)
