"""The input of a policy that looks ahead: the coming calls, the servers in range of each, and the times of checks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import CHECKING, FULL_S, Server, State
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import CallClock, ExpectedCall
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer


@dataclass(frozen=True, slots=True)
class Forecast:
    """The coming calls with the servers that could take them; the current check is over in `ready_in_s`.

    `peers` has for a server the others that it can have prepared.
    """

    calls: Sequence[ComingCall]
    checks: Mapping[str, CheckTimes]
    ready_in_s: float
    peers: Mapping[str, frozenset[str]] = field(default_factory=dict)


def make_forecast(
    expected: Sequence[ExpectedCall],
    servers: Mapping[str, Server],
    estimates: Estimates,
    selected: Sequence[Server],
    *,
    now_s: float,
    banned_s: Mapping[str, float],
    idle_s: float,
) -> Forecast:
    """The forecast for the expected calls, without servers that are no faster or still blacklisted at the call.

    `banned_s` has the seconds left of each blacklisting. The first of the selected servers is in use; the check of
    the second goes on in any case.
    """
    local_s = estimates.mean_call_s()
    seen: dict[str, float] = {}
    for call in expected:
        seen.update(call.in_range_s)
    gaining = {
        name: servers[name]
        for name in seen
        if any(
            estimates.mean_call_s(name, call.position) < local_s
            for call in (expected if estimates.is_measured(name) else expected[:1])  # elsewhere all are alike
        )
    }
    checks = {
        name: CheckTimes(
            stopped_s=estimates.check_s(name, running=False),
            running_s=estimates.check_s(name, running=True),
            runs_for_s=server.since_s + idle_s - now_s if server.state is State.AVL_R else 0.0,
        )
        for name, server in gaining.items()
    }
    for server in selected[1:]:
        if server.name in checks:
            rest_s = rest_of_check_s(server, estimates, now_s)
            checks[server.name] = CheckTimes(stopped_s=rest_s, running_s=rest_s)
    return Forecast(
        list(_calls(expected, estimates, gaining, banned_s)),
        checks,
        rest_of_check_s(selected[0], estimates, now_s) if selected else 0.0,
        {name: server.peers for name, server in gaining.items() if server.peers},
    )


def rest_of_check_s(server: Server, estimates: Estimates, now_s: float) -> float:
    """The expected seconds left of a selected server's check; 0 if it is READY."""
    if server.state not in CHECKING:
        return 0.0
    if server.is_full(now_s):
        return FULL_S
    check_s = estimates.check_s(server.name, running=server.state is State.CHECK_R)
    return max(0.0, check_s - (now_s - server.checked_since_s))


def _calls(
    expected: Sequence[ExpectedCall],
    estimates: Estimates,
    gaining: Iterable[str],
    banned_s: Mapping[str, float],
) -> Iterator[ComingCall]:
    clock = CallClock()
    measured = {server for server in gaining if estimates.is_measured(server)}
    delays_s: dict[Operation, tuple[float, dict[str, float]]] = {}  # on the drone, and by server
    for call in expected:
        before_s = clock.at_s
        clock.begin(call)
        if (known := delays_s.get(call.operation)) is None:
            local_s = estimates.alone_s(call.operation) or 0.0
            remote_s = {server: estimates.remote_s(server, call.operation) for server in gaining}
            at_servers_s = {
                server: local_s if delay_s is None else delay_s for server, delay_s in remote_s.items()
            }
            known = delays_s[call.operation] = local_s, at_servers_s
        local_s, its_delays_s = known
        offers = []
        for server, in_range_s in call.in_range_s.items():
            allowed_s = clock.at_s - banned_s.get(server, -math.inf)
            if server in its_delays_s and allowed_s > 0:
                call_s = its_delays_s[server]
                if server in measured:
                    call_s = estimates.remote_s(server, call.operation, call.position) or call_s
                offers.append(Offer(server, call_s, min(in_range_s, allowed_s)))
        yield ComingCall(local_s, max(0.0, clock.at_s - before_s) if call.hides else call.gap_s, offers)
        if call.hides:
            clock.end(min([local_s, *(offer.call_s for offer in offers)]))
