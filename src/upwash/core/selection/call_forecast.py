"""The place where each coming call is expected to run, by the policy and by what is known now.

What holds in this small world:
- the policy decides at each call, and the check of a chosen server begins when its range was entered;
- calls take their estimates, and a server that was checked once runs its services from then on;
- a server that cannot be used now can be used after that time; nothing fails.

One pass over the calls, so that a small computer can look at hundreds of them before each call.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from upwash.core.geo import Position
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import State
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import CallClock, ExpectedCall
from upwash.core.policies.policy import CallInputs, Local, Option, Policy, Remote, Situation


class CallPlace(Struct, frozen=True):
    """The server selected at a call, if any, and the seconds until it is ready."""

    server: str | None = None
    ready_in_s: float = 0.0


@dataclass(slots=True, eq=False)
class CallForecast:
    """Foresees the places of coming calls, from the server in use and the estimates of one moment.

    `unusable_s` has the seconds until a server may be used; services run on the servers of `running`. Calls with two
    answers are over with the `first` one, or the server's if that is sooner.
    """

    _policy: Policy
    _estimates: Estimates
    here: CallPlace
    unusable_s: Mapping[str, float]
    running: set[str] = field(default_factory=set)
    first: Mapping[Operation, Operation] = field(default_factory=dict)
    _choices: dict[tuple[str | None, tuple[str, ...], Position | None], str | None] = field(
        default_factory=dict
    )
    _delays_s: dict[tuple[CallPlace, Operation, Position | None], float] = field(default_factory=dict)

    def places(self, calls: Iterable[ExpectedCall]) -> Iterator[CallPlace]:
        """The place of each call, in the order of the calls."""
        clock, here = CallClock(), self.here
        for call in calls:
            clock.begin(call)
            server = self._server(here.server, call, clock.at_s)
            if server is None:
                here = CallPlace()
            elif server == here.server:
                here = CallPlace(server, max(0.0, here.ready_in_s - call.gap_s))
            else:
                check_s = self._estimates.check_s(server, running=server in self.running)
                here = CallPlace(server, max(0.0, check_s - call.in_range_s[server]))
                self.running.add(server)
            yield here
            delay_s = self.delay_s(here, call)
            clock.end(delay_s)
            here = CallPlace(here.server, max(0.0, here.ready_in_s - (0.0 if call.hides else delay_s)))

    def delay_s(self, place: CallPlace, call: ExpectedCall, operation: Operation | None = None) -> float:
        """The seconds that the call takes there, with the wait for a check; `operation` replaces the call's own."""
        operation = operation or call.operation
        # Elsewhere the delay is the same at all places.
        at = call.position if self._estimates.is_measured(place.server) else None
        key = place, operation, at
        delay_s = self._delays_s.get(key)
        if delay_s is None:
            delay_s, first = self._placed_s(*key), self.first.get(operation)
            first_s = None if first is None else self._estimates.local_s(first)
            delay_s = self._delays_s[key] = delay_s if first_s is None else min(first_s, delay_s)
        return delay_s

    def _placed_s(self, place: CallPlace, operation: Operation, at: Position | None) -> float:
        server, local_s = place.server, self._estimates.local_s(operation) or 0.0
        remote_s = self._estimates.remote_s(server, operation, at) if server is not None else None
        if server is None or remote_s is None:
            return local_s
        if self._estimates.needs_server(operation):  # a drone that would have to wait flies on
            return 0.0 if place.ready_in_s > 0 else remote_s
        state = State.CHECK if place.ready_in_s > 0 else State.READY
        decision = self._policy.decide(
            CallInputs(
                server,
                state,
                local_s,
                remote_s,
                check_expected_s=place.ready_in_s,
                check_elapsed_s=0.0,
                is_foreseen=True,
            )
        )
        if isinstance(decision, Local):
            return local_s
        return remote_s if isinstance(decision, Remote) else place.ready_in_s + remote_s

    def _server(self, current: str | None, call: ExpectedCall, at_s: float) -> str | None:
        usable = [name for name in call.in_range_s if self.unusable_s.get(name, 0.0) <= at_s]
        usable.sort(key=lambda name: -call.in_range_s[name])
        at = call.position if any(self._estimates.is_measured(name) for name in usable) else None
        seen = current if current in usable else None, tuple(usable), at
        if seen not in self._choices:
            options = [
                Option(name, self._estimates.mean_call_s(name, at), in_range_since_s=rank)
                for rank, name in enumerate(usable)
            ]
            situation = Situation(options, seen[0], self._estimates.mean_call_s())
            self._choices[seen] = self._policy.choose(situation).server
        return self._choices[seen]
