"""Which server for which of the calls to come, with one radio, so that they are over soonest.

What holds in this small world:
- between two calls the drone may leave its server and check another one, from when it is in that one's range;
- a check that is not over when a call is made is waited for, or the call runs on the drone and the check goes on;
- a server that was checked once runs its services from then on;
- a server that is ready has its peers start their services from then on.

Call by call, the ways to get so far are carried on: those that no other beats in its cost, in what is left of the
check, or in the services that it has started. Of the latter only two sets are followed, as there would be too many.
So the schedule is the best one where a check takes as long whether the services run or not, and nearly so elsewhere.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
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


class _Way(NamedTuple):
    cost_s: float
    ready_in_s: float  # what is left of the server's check
    server: str | None
    started: frozenset[str]
    since_s: float  # when that check is over
    before: _Way | None


_Arrival = tuple[_Way, float, float]  # at a call: what is left of the server's check, and when it is over
_cost_and_rest = itemgetter(0, 1)
_MOST_STARTED = 2  # sets of servers that ways may have started the services of
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
    ways = [_Way(0.0, ready_in_s, server, started, ready_in_s, None)]
    begins_s = 0.0
    for call in calls:
        ways = list(_over(call, ways, useful, peers, begins_s=begins_s, gain_wait=gain_wait, stays=stays))
        begins_s += call.gap_s
        stays = False
    best = min(ways, key=_cost_and_rest)
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
    ways: Sequence[_Way],
    checks: Mapping[str, CheckTimes],
    peers: Mapping[str, frozenset[str]],
    *,
    begins_s: float,
    gain_wait: float,
    stays: bool,
) -> Iterator[_Way]:
    """The ways that lead over one more call: on without a server, with the same one, or with another."""
    cheapest = _cheapest(ways)
    for way in cheapest:
        yield _Way(way.cost_s + call.local_s, math.inf, None, way.started, math.inf, way)
    by_server: dict[str | None, list[_Way]] = {}
    for way in ways:
        by_server.setdefault(way.server, []).append(way)
    longest_s = call.local_s * (1 - gain_wait)
    for offer in call.offers:
        times = checks.get(offer.server)
        if times is None:
            continue
        arrivals: list[_Arrival] = []
        never_left = offer.head_start_s >= call.gap_s
        if never_left:
            arrivals = [
                (way, way.ready_in_s - call.gap_s, way.since_s) for way in by_server.get(offer.server, ())
            ]
        if not stays:
            for way in cheapest:
                if not (never_left and way.server == offer.server):
                    called_s = begins_s + call.gap_s + way.cost_s
                    check_s = times.stopped_s
                    if offer.server in way.started or begins_s < times.runs_for_s:
                        check_s = times.running_s
                    elif way.server is not None and offer.server in peers.get(way.server, ()):
                        prepared_s = max(0.0, called_s - offer.head_start_s - way.since_s)
                        check_s = max(times.running_s, times.stopped_s - prepared_s)
                    left_s = check_s - offer.head_start_s
                    arrivals.append((way, left_s, called_s + left_s))
        yield from _unbeaten(_served(arrivals, offer, times, call.local_s, longest_s))


def _served(
    arrivals: Iterable[_Arrival], offer: Offer, times: CheckTimes, local_s: float, longest_s: float
) -> Iterator[_Way]:
    """The ways over a call that is made with so much of the server's check left."""
    for way, left_s, since_s in arrivals:
        if left_s <= 0:
            cost_s, rest_s = way.cost_s + min(local_s, offer.call_s), 0.0
        elif left_s + offer.call_s < longest_s:
            cost_s, rest_s = way.cost_s + left_s + offer.call_s, 0.0
        else:
            cost_s, rest_s = way.cost_s + local_s, max(0.0, left_s - local_s)
        started = _with_started(way.started, offer.server, times, rest_s)
        yield _Way(cost_s, rest_s, offer.server, started, since_s, way)


def _with_started(started: frozenset[str], server: str, times: CheckTimes, rest_s: float) -> frozenset[str]:
    """With the server whose check has so much left, if it has surely been asked to start its services by then."""
    if server in started or rest_s > times.stopped_s - times.running_s - _ASKING_S:
        return started
    return started | {server}


def _cheapest(ways: Iterable[_Way]) -> list[_Way]:
    """The cheapest way of all, and the cheapest that has started something else."""
    ordered = sorted(ways, key=_cost_and_rest)
    others = (way for way in ordered if not way.started <= ordered[0].started)
    return [ordered[0], *itertools.islice(others, _MOST_STARTED - 1)]


def _unbeaten(ways: Iterable[_Way]) -> list[_Way]:
    """The ways to one server that no cheaper one beats in what is left of the check or in what it has started."""
    ordered = sorted(ways, key=_cost_and_rest)
    best = ordered[:1]
    for way in ordered[1:]:
        beaten = any(other.ready_in_s <= way.ready_in_s and other.started >= way.started for other in best)
        if not beaten and len({way.started, *(other.started for other in best)}) <= _MOST_STARTED:
            best.append(way)
    return best


def _servers(way: _Way) -> list[str | None]:
    servers = []
    while way.before is not None:
        servers.append(way.server)
        way = way.before
    return servers[::-1]
