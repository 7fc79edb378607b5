"""The server to use at each coming call, with one radio, so that the calls are over soonest.

What holds in this small world:
- between two calls the drone may leave its server and check another, as soon as it is in range of that;
- a check that is not over at a call is waited for, or the call runs on the drone and the check goes on;
- a server that was checked once runs its services from then on;
- a server that is ready has its peers start their services from then on.

The search goes call by call. It keeps a label for each way through the calls so far, unless a cheaper label has no
more of its check left and has started the same services. It follows only two sets of started services. So the
schedule is the best if checks take as long with services running as without, and nearly the best otherwise.

It first follows only ways that lose little against each call at its fastest place without a wait. If such a way
exists, the search ends there: every way left out costs more than the followed ways, and still does at its end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter, ge, le
from types import MappingProxyType
from typing import NamedTuple

from msgspec import Struct


class Offer(Struct, frozen=True, gc=False):
    """A server in range at a call, and the delay of the call there.

    The server's check can begin `head_start_s` before the call: the time in range since the call before, at most
    `gap_s`.
    """

    server: str
    call_s: float
    head_start_s: float


class ComingCall(Struct, frozen=True):
    """A call `gap_s` after the end of the call before; the first, after now."""

    local_s: float
    gap_s: float
    offers: Sequence[Offer]

    def times(self, count: int) -> ComingCall:
        """The call and others like it behind it, as one."""
        offers = [Offer(offer.server, count * offer.call_s, offer.head_start_s) for offer in self.offers]
        return ComingCall(count * self.local_s, self.gap_s, offers)


class CheckTimes(Struct, frozen=True):
    """The seconds of a check with services stopped or running; they run for `runs_for_s` from now."""

    stopped_s: float
    running_s: float
    runs_for_s: float = 0.0


class Schedule(Struct, frozen=True):
    """The server to use at each call, if any, and the sum of the delays of all calls, waits included."""

    servers: Sequence[str | None]
    total_s: float


class _Label(Struct, gc=False):
    """One way through the calls so far."""

    cost_s: float
    ready_in_s: float  # what is left of the server's check
    server: str | None
    started: int  # the servers whose services it has started, a bit for each
    since_s: float  # when that check is over
    before: _Label | None


class _Useful(Struct, gc=False):
    """A server that may be part of the best schedule, and its bit in sets of started servers."""

    check: CheckTimes
    bit: int
    told_s: float  # the rest of its check at which its services have surely been started


class _Stage(NamedTuple):
    """A call, the gaps before it, its useful offers, and the least delay of all later calls."""

    call: ComingCall
    begins_s: float  # without its own gap
    offers: Sequence[tuple[Offer, _Useful]]
    then_s: float


_Track = tuple[list[float], list[float]]  # a server's delays and head starts; inf and -inf where it has none
_Arrival = tuple[_Label, float, float]  # at a call: what is left of the server's check, and when it is over
_cost_and_rest = attrgetter("cost_s", "ready_in_s")
_MOST_STARTED = 2  # sets of servers that labels may have started the services of
_ASKING_S = 1.0  # of a check, before which perhaps no service was started
_LITTLE = 0.2  # of a local call: what a schedule may lose that is looked for first


def quickest(
    calls: Sequence[ComingCall],
    checks: Mapping[str, CheckTimes],
    *,
    server: str | None = None,
    ready_in_s: float = 0.0,
    gain_wait: float = 0.0,
    stays: bool = False,
    peers: Mapping[str, frozenset[str]] = MappingProxyType({}),
    most_labels: int | None = None,
) -> Schedule:
    """The schedule of least total delay, with `server` selected and its check over in `ready_in_s`.

    A call waits only if that saves more than the fraction `gain_wait` of a local call. A drone that `stays` keeps
    its server until after the first call. Each server prepares its `peers`. With `most_labels` only that many ways,
    the cheapest, are followed from call to call.
    """
    useful = _useful(calls, checks, server, peers)
    stages, least_s = _stages(calls, useful)
    little_s = _LITTLE * max((call.local_s for call in calls), default=0.0)
    started = useful[server].bit if server in useful and ready_in_s <= useful[server].told_s else 0
    first = _Label(0.0, ready_in_s, server, started, ready_in_s, None)

    def labels_within(most_s: float) -> list[_Label]:
        """The labels after the last call that cost at most `most_s`."""
        labels = [first]
        for stage in stages:
            stays_now = stays and labels[0] is first
            labels = _over(stage, labels, peers, most_s=most_s, gain_wait=gain_wait, stays=stays_now)
            if most_labels is not None and len(labels) > most_labels:
                labels = sorted(labels, key=_cost_and_rest)[:most_labels]
            if not labels:
                break
        return labels

    best = min(labels_within(least_s + little_s) or labels_within(math.inf), key=_cost_and_rest)
    total_s, servers = best.cost_s, []
    while best.before is not None:
        servers.append(best.server)
        best = best.before
    return Schedule(servers[::-1], total_s)


def _stages(calls: Sequence[ComingCall], useful: Mapping[str, _Useful]) -> tuple[Sequence[_Stage], float]:
    begins_s = list(itertools.accumulate((call.gap_s for call in calls), initial=0.0))
    stages, least_s = [], 0.0
    for call, begin_s in zip(reversed(calls), begins_s[-2::-1], strict=True):
        offers = [(offer, useful[offer.server]) for offer in call.offers if offer.server in useful]
        stages.append(_Stage(call, begin_s, offers, least_s))
        least_s += min([call.local_s, *[offer.call_s for offer, _ in offers]])
    return stages[::-1], least_s


def _useful(
    calls: Sequence[ComingCall],
    checks: Mapping[str, CheckTimes],
    server: str | None,
    peers: Mapping[str, frozenset[str]],
) -> dict[str, _Useful]:
    """The selected server, and each server that no other beats at every call."""
    tracks: dict[str, _Track] = {}
    for number, call in enumerate(calls):
        for offer in call.offers:
            track = tracks.get(offer.server)
            if track is None:
                track = tracks[offer.server] = [math.inf] * len(calls), [-math.inf] * len(calls)
            track[0][number] = offer.call_s
            track[1][number] = offer.head_start_s
    useful: dict[str, _Useful] = {}

    def rank(name: str) -> tuple[int, float]:
        """Sort servers in range of most calls first, then fast servers."""
        in_range = list(filter(math.isfinite, tracks[name][0]))
        return -len(in_range), sum(in_range)

    for name in sorted(tracks, key=rank):
        calls_s, head_starts_s = tracks[name]
        for other, its in useful.items():
            its_calls_s, its_head_starts_s = tracks[other]
            if (
                name != server
                and its.check.stopped_s <= checks[name].stopped_s
                and its.check.running_s <= checks[name].running_s
                and its.check.runs_for_s >= checks[name].runs_for_s
                and all(map(le, its_calls_s, calls_s))
                and all(map(ge, its_head_starts_s, head_starts_s))
                and (not peers or _is_no_lonelier(other, name, peers))
            ):
                break
        else:
            check = checks[name]
            useful[name] = _Useful(check, 1 << len(useful), check.stopped_s - check.running_s - _ASKING_S)
    return useful


def _is_no_lonelier(server: str, other: str, peers: Mapping[str, frozenset[str]]) -> bool:
    """Whether the server has all peers of `other`, and each server that can prepare `other` can prepare it."""
    nobody = frozenset[str]()
    has_them = peers.get(other, nobody) - {server} <= peers.get(server, nobody)
    return has_them and all(
        server in told for name, told in peers.items() if other in told and name != server
    )


def _over(
    stage: _Stage,
    labels: Sequence[_Label],
    peers: Mapping[str, frozenset[str]],
    *,
    most_s: float,
    gain_wait: float,
    stays: bool,
) -> list[_Label]:
    """The labels after one more call, on the drone or on any server, that can end within `most_s`."""
    call, begins_s, offers, then_s = stage
    local_s, gap_s = call.local_s, call.gap_s
    most_s -= then_s
    longest_s = local_s * (1 - gain_wait)
    cheapest = _cheapest(labels)
    after = [
        _Label(label.cost_s + local_s, math.inf, None, label.started, math.inf, label)
        for label in cheapest
        if label.cost_s + local_s <= most_s
    ]
    for offer, useful in offers:
        server, head_start_s, check = offer.server, offer.head_start_s, useful.check
        arrivals: list[_Arrival] = []
        never_left = head_start_s >= gap_s
        if never_left:
            arrivals = [
                (label, label.ready_in_s - gap_s, label.since_s) for label in labels if label.server == server
            ]
        for label in () if stays else cheapest:
            if never_left and label.server == server:
                continue
            called_s = begins_s + gap_s + label.cost_s
            check_s = check.stopped_s
            if label.started & useful.bit or begins_s < check.runs_for_s:
                check_s = check.running_s
            elif label.server is not None and server in peers.get(label.server, ()):
                prepared_s = max(0.0, called_s - head_start_s - label.since_s)
                check_s = max(check.running_s, check.stopped_s - prepared_s)
            left_s = check_s - head_start_s
            arrivals.append((label, left_s, called_s + left_s))
        served = _served(arrivals, offer, useful, local_s=local_s, longest_s=longest_s, most_s=most_s)
        after += _unbeaten(served)
    return after


def _served(
    arrivals: Iterable[_Arrival],
    offer: Offer,
    useful: _Useful,
    *,
    local_s: float,
    longest_s: float,
    most_s: float,
) -> list[_Label]:
    """The label after the call for each arrival; those that cost more than `most_s` are left out."""
    served = []
    call_s, told_s, bit = offer.call_s, useful.told_s, useful.bit
    ready_s = min(local_s, call_s)
    for label, left_s, since_s in arrivals:
        if left_s <= 0:
            cost_s, rest_s = label.cost_s + ready_s, 0.0
        elif left_s + call_s < longest_s:
            cost_s, rest_s = label.cost_s + left_s + call_s, 0.0
        else:
            cost_s, rest_s = label.cost_s + local_s, max(0.0, left_s - local_s)
        if cost_s <= most_s:
            started = label.started if rest_s > told_s else label.started | bit
            served.append(_Label(cost_s, rest_s, offer.server, started, since_s, label))
    return served


def _cheapest(labels: Sequence[_Label]) -> Sequence[_Label]:
    """The cheapest label, and the cheapest label that has started another service."""
    if len(labels) == 1:
        return labels
    first = min(labels, key=_cost_and_rest)
    others = [label for label in labels if label.started & ~first.started]
    return [first, min(others, key=_cost_and_rest)] if others else [first]


def _unbeaten(served: list[_Label]) -> list[_Label]:
    """Drop labels that a cheaper one beats in the rest of the check and in started services."""
    if len(served) <= 1:
        return served
    best: list[_Label] = []
    for label in sorted(served, key=_cost_and_rest):
        rest_s, started = label.ready_in_s, label.started
        for other in best:
            if other.ready_in_s <= rest_s and not started & ~other.started:
                break
        else:
            if len(best) < _MOST_STARTED or len({started, *(each.started for each in best)}) <= _MOST_STARTED:
                best.append(label)
    return best
