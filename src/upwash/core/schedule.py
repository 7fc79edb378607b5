"""Which server for which of the calls to come, with one radio, so that they are over soonest.

What holds in this small world:
- between two calls the drone may leave its server and check another one, from when it is in that one's range;
- a check that is not over when a call is made is waited for, or the call runs on the drone and the check goes on;
- a server that was checked once runs its services from then on;
- a server that is ready has its peers start their services from then on.

The search goes call by call. It keeps a label for each way to get so far, unless a cheaper one is no worse in what is
left of the check and in the services that it has started. Of the latter it follows only two sets, as there would be
too many: the schedule is the best one where a check takes as long whether the services run or not, and nearly so
elsewhere.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Offer:
    """A server in whose range a call will be made, and the delay of the call there.

    `head_start_s` is how long before the call its check can begin: the time in range since the call before, which is
    the whole `gap_s` of the call where its range was not left.
    """

    server: str
    call_s: float
    head_start_s: float


@dataclass(frozen=True, slots=True)
class ComingCall:
    """A call that will be made `gap_s` after the end of the one before; the first, so long after now."""

    local_s: float
    gap_s: float
    offers: Sequence[Offer]


@dataclass(frozen=True, slots=True)
class CheckTimes:
    """How long a check of a server takes; its services are known to run for `runs_for_s` from now."""

    stopped_s: float
    running_s: float
    runs_for_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Schedule:
    """The server to be on at each call, if any, and the delay of all the calls, waits included."""

    servers: Sequence[str | None]
    total_s: float


class _Label(NamedTuple):
    """One way to get through the calls so far."""

    cost_s: float
    ready_in_s: float  # what is left of the server's check
    server: str | None
    started: frozenset[str]
    since_s: float  # when that check is over
    before: _Label | None


_Arrival = tuple[_Label, float, float]  # at a call: what is left of the server's check, and when it is over
_cost_and_rest = itemgetter(0, 1)
_MOST_STARTED = 2  # sets of servers that labels may have started the services of
_ASKING_S = 1.0  # a server that is left sooner has perhaps not been told to start anything


def quickest(
    calls: Sequence[ComingCall],
    checks: Mapping[str, CheckTimes],
    *,
    server: str | None = None,
    ready_in_s: float = 0.0,
    gain_wait: float = 0.0,
    stays: bool = False,
    peers: Mapping[str, frozenset[str]] = MappingProxyType({}),
) -> Schedule:
    """The schedule of least total delay from now on, with `server` selected and its check over in `ready_in_s`.

    A call waits only where that makes it shorter than a local one by more than the fraction `gain_wait`. A drone
    that `stays` does not leave its server before the first call. `peers` are those that each server has prepared.
    """
    useful = _useful(calls, checks, server, peers)
    started = frozenset[str]()
    if server in useful:
        started = _with_started(started, server, useful[server], ready_in_s)
    labels = [_Label(0.0, ready_in_s, server, started, ready_in_s, None)]
    begins_s = 0.0
    for call in calls:
        labels = _over(call, labels, useful, peers, begins_s=begins_s, gain_wait=gain_wait, stays=stays)
        begins_s += call.gap_s
        stays = False
    best = min(labels, key=_cost_and_rest)
    return Schedule(_servers(best), best.cost_s)


def _useful(
    calls: Sequence[ComingCall],
    checks: Mapping[str, CheckTimes],
    server: str | None,
    peers: Mapping[str, frozenset[str]],
) -> dict[str, CheckTimes]:
    """The servers that are better than each other one at some call, and the one that is selected."""
    offers: dict[str, dict[int, Offer]] = {}
    for number, call in enumerate(calls):
        for offer in call.offers:
            offers.setdefault(offer.server, {})[number] = offer
    best_first = sorted(
        offers, key=lambda name: (-len(offers[name]), sum(each.call_s for each in offers[name].values()))
    )
    useful: dict[str, CheckTimes] = {}
    for name in best_first:
        beaten = any(
            _is_no_worse(checks[other], checks[name])
            and all(
                (its := offers[other].get(number)) is not None
                and its.call_s <= offer.call_s
                and its.head_start_s >= offer.head_start_s
                for number, offer in offers[name].items()
            )
            and _is_no_lonelier(other, name, peers)
            for other in useful
        )
        if name == server or not beaten:
            useful[name] = checks[name]
    return useful


def _is_no_worse(times: CheckTimes, others: CheckTimes) -> bool:
    return (
        times.stopped_s <= others.stopped_s
        and times.running_s <= others.running_s
        and times.runs_for_s >= others.runs_for_s
    )


def _is_no_lonelier(server: str, other: str, peers: Mapping[str, frozenset[str]]) -> bool:
    """Whether it has all the peers that the other has, and is prepared by all that prepare the other."""
    nobody = frozenset[str]()
    has_them = peers.get(other, nobody) - {server} <= peers.get(server, nobody)
    return has_them and all(
        server in told for name, told in peers.items() if other in told and name != server
    )


def _over(
    call: ComingCall,
    labels: Sequence[_Label],
    checks: Mapping[str, CheckTimes],
    peers: Mapping[str, frozenset[str]],
    *,
    begins_s: float,
    gain_wait: float,
    stays: bool,
) -> list[_Label]:
    """The labels after one more call: without a server, with the same one, or with another."""
    cheapest = _cheapest(labels)
    after = [
        _Label(label.cost_s + call.local_s, math.inf, None, label.started, math.inf, label)
        for label in cheapest
    ]
    by_server: dict[str | None, list[_Label]] = {}
    for label in labels:
        by_server.setdefault(label.server, []).append(label)
    longest_s = call.local_s * (1 - gain_wait)
    for offer in call.offers:
        times = checks.get(offer.server)
        if times is None:
            continue
        arrivals: list[_Arrival] = []
        never_left = offer.head_start_s >= call.gap_s
        if never_left:
            arrivals = [
                (label, label.ready_in_s - call.gap_s, label.since_s)
                for label in by_server.get(offer.server, ())
            ]
        if not stays:
            for label in cheapest:
                if not (never_left and label.server == offer.server):
                    called_s = begins_s + call.gap_s + label.cost_s
                    check_s = times.stopped_s
                    if offer.server in label.started or begins_s < times.runs_for_s:
                        check_s = times.running_s
                    elif label.server is not None and offer.server in peers.get(label.server, ()):
                        prepared_s = max(0.0, called_s - offer.head_start_s - label.since_s)
                        check_s = max(times.running_s, times.stopped_s - prepared_s)
                    left_s = check_s - offer.head_start_s
                    arrivals.append((label, left_s, called_s + left_s))
        after += _unbeaten(_served(arrivals, offer, times, call.local_s, longest_s))
    return after


def _served(
    arrivals: Iterable[_Arrival], offer: Offer, times: CheckTimes, local_s: float, longest_s: float
) -> list[_Label]:
    """The labels after a call that is made with so much of the server's check left."""
    labels = []
    server, call_s = offer.server, offer.call_s
    ready_s = min(local_s, call_s)
    for label, left_s, since_s in arrivals:
        if left_s <= 0:
            cost_s, rest_s = label.cost_s + ready_s, 0.0
        elif left_s + call_s < longest_s:
            cost_s, rest_s = label.cost_s + left_s + call_s, 0.0
        else:
            cost_s, rest_s = label.cost_s + local_s, max(0.0, left_s - local_s)
        started = _with_started(label.started, server, times, rest_s)
        labels.append(_Label(cost_s, rest_s, server, started, since_s, label))
    return labels


def _with_started(started: frozenset[str], server: str, times: CheckTimes, rest_s: float) -> frozenset[str]:
    """With the server whose check has so much left, if it has surely been asked to start its services by then."""
    if server in started or rest_s > times.stopped_s - times.running_s - _ASKING_S:
        return started
    return started | {server}


def _cheapest(labels: Sequence[_Label]) -> list[_Label]:
    """The cheapest label, and the cheapest that has started something else."""
    first = min(labels, key=_cost_and_rest)
    others = [label for label in labels if not label.started <= first.started]
    return [first, *heapq.nsmallest(_MOST_STARTED - 1, others, key=_cost_and_rest)]


def _unbeaten(labels: list[_Label]) -> list[_Label]:
    """The labels of one server that no cheaper one beats in what is left of the check or in what it has started."""
    if len(labels) == 1:
        return labels
    ordered = sorted(labels, key=_cost_and_rest)
    best = ordered[:1]
    for label in ordered[1:]:
        beaten = any(
            other.ready_in_s <= label.ready_in_s and other.started >= label.started for other in best
        )
        if not beaten and len({label.started, *(other.started for other in best)}) <= _MOST_STARTED:
            best.append(label)
    return best


def _servers(label: _Label) -> list[str | None]:
    servers = []
    while label.before is not None:
        servers.append(label.server)
        label = label.before
    return servers[::-1]
