"""All calls of one drone: the line of calls, the lanes of places, and the drone's own computer.

    in line         Several calls may be open. The oldest is first, or the newest, as configured. Calls that the
                    mission waits for come before all others. Then come the calls that only servers compute.
    its place       The policy chooses the place of a call. By default a free place takes the first call that it would
                    answer before the other place (core/planning/earliest.py). A call that runs once is the drone's.
    decided         A call is decided once its place is free. Then the next call is decided.
    on the drone    The computations of a service run one after the other.

A call holds the lane of its place from the decision until its answer, wherever it is computed in the end. Each other
attempt at it holds the lane of its own place too (core/selection/lanes.py).
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing, hangs_after_s
from upwash.core.call.call import Call
from upwash.core.call.on_servers import OnServers
from upwash.core.call.outcomes import Outcomes
from upwash.core.call.steps import CallEvent, Instruction
from upwash.core.geo import Position
from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import Decision, Local, PolicyDefect, Remote, Wait
from upwash.core.selection import events
from upwash.core.selection.deadlines import Deadlines
from upwash.core.selection.events import SelectionEvent
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.lanes import InLine
from upwash.core.selection.selection import Selection
from upwash.eventlog import schema

LONGEST_UNUSED_S = 60.0  # that a policy may leave both lanes free beside a line
_NAMES: Mapping[type[Decision], Literal["local", "remote", "wait"]] = {
    Local: "local",
    Remote: "remote",
    Wait: "wait",
}


@dataclass(slots=True, eq=False, kw_only=True)
class _Waiting(InLine):
    """A call in line."""

    call: Call


class Calls:
    """The machine of one drone's calls; `handle` takes events in, and returns instructions in their order.

    With `first`, the order of calls in line, several calls may be open at the same time. `waiting_bytes` bounds the
    requests of each service that wait for servers.
    """

    def __init__(
        self,
        selection: Selection,
        hedging: Hedging,
        deadlines: Deadlines,
        *,
        first: Literal["oldest", "newest"] | None = None,
        waiting_bytes: Mapping[str, int] = MappingProxyType({}),
    ) -> None:
        self.selection, self.hedging, self.deadlines = selection, hedging, deadlines
        self.placement, self.estimates, self.lanes = selection.placement, selection.estimates, selection.lanes
        self.lanes.newest_first, self.lanes.has_line = first == "newest", first is not None
        self.outcomes = Outcomes(self)
        self.now_s, self.here = 0.0, Position(0.0, 0.0)
        self.news = 0  # how many changes there were for calls that wait
        self.happened = 0  # how many events were taken in, and calls have ended
        self.told = 0  # how many events and decisions the selection has had
        self.wanted: dict[Call, float] = {}  # calls for a better answer, and by when each must be sent
        self._waiting_bytes = waiting_bytes
        self._looked_s = -math.inf
        self._out: list[Instruction] = []
        self._open: list[Call] = []
        self._losers: set[Attempt | Computing] = set()  # that go on after their calls were answered
        self._own = defaultdict[str, deque[Computing]](deque)  # of each service; the first runs
        self._places: dict[Call, _Waiting] = {}  # in line, or the holder of a lane
        self._deciding: Call | None = None
        self._unused_since_s: float | None = None  # both lanes, beside calls that the drone could compute

    def handle(
        self, event: CallEvent | SelectionEvent, *, now_s: float, position: Position
    ) -> list[Instruction]:
        """Take in what has happened at the position; return what the program has to do, in that order."""
        self.now_s, self.here = now_s, position
        self.happened += not isinstance(event, steps.Recheck)
        if isinstance(event, SelectionEvent):
            self.tell(event)
        else:
            self.selection.locate(position, now_s)
            self._take_in(event)
        out, self._out = self._out, []
        return out

    def _take_in(self, event: CallEvent) -> None:
        match event:
            case steps.Recheck():
                self._look()
            case steps.Made(call):
                self._make(call)
            case steps.Waited(call):
                call.is_waited_for = True
                if isinstance(call.manner, OnServers):
                    call.manner.hurry()
                self.wake()
            case steps.Enough(call):
                call.is_enough = True
                if isinstance(call.manner, OnServers):
                    call.manner.limit("the mission dropped it")
                self.wake()
            case steps.Abandoned(call):
                call.abandon()
            case steps.EndWaiting(why):
                for waiting in self.waiting:
                    waiting.limit(why)
            case steps.Computed(computing):
                computing.call.computed(event)
            case _:
                self.outcomes.take_in(event)

    @property
    def due_s(self) -> float:
        """When `News` must be handled, unless an event comes before; over if an event came first at that time."""
        times_s = [due_s for call in self._open for due_s in call.due_s]
        if self._unused_since_s is not None:
            times_s.append(self._unused_since_s + LONGEST_UNUSED_S)
        return min((due_s for due_s in times_s if due_s > self._looked_s), default=math.inf)

    @property
    def await_news(self) -> bool:
        """Whether news may help a call: a call that waits for an answer or for a time needs no news."""
        return bool(self.lanes.line) or any(call.awaits_news for call in self._open)

    @property
    def waiting(self) -> list[OnServers]:
        """The open calls that only servers compute, the oldest first."""
        return [call.manner for call in self._open if isinstance(call.manner, OnServers)]

    @property
    def is_busy(self) -> bool:
        """Whether the drone computes, or a loser goes on."""
        return bool(self._losers) or not self.lanes.is_free(ON_DRONE)

    # --- out ------------------------------------------------------------------------------------------------

    def do(self, step: Instruction) -> None:
        """Add an instruction."""
        self._out.append(step)

    def wake(self) -> None:
        """Note that calls may have what they wait for."""
        self.news += 1

    def tell(self, event: SelectionEvent) -> None:
        """Pass the event on to the selection, and its effects to the program."""
        self._out += self.selection.handle(event, now_s=self.now_s, position=self.here)
        self.told += 1
        self.wake()

    # --- the line -------------------------------------------------------------------------------------------

    def _make(self, call: Call) -> None:
        self._open.append(call)
        call.make(self)
        if call.asked.on_servers:
            self._bound_waiting(call.asked.operation.service)
        self.enter(call, on_drone=call.asked.once)
        if call.is_waited_for and isinstance(call.manner, OnServers):
            call.manner.hurry()

    def _bound_waiting(self, service: str) -> None:
        """End the oldest waiting calls of a service whose requests need more memory than they may."""
        most_bytes = self._waiting_bytes[service]
        its = [each for each in self.waiting if each.call.asked.operation.service == service]
        sizes = [each.call.asked.size_bytes(each.call.asked.operation) for each in its]
        over_bytes = sum(sizes) - most_bytes
        for each, size_bytes in zip(its, sizes, strict=True):
            if over_bytes > 0:
                each.limit(
                    f"calls that wait for a server keep more than service.waiting_bytes = {most_bytes}"
                )
                over_bytes -= size_bytes

    def enter(self, call: Call, *, on_drone: bool = False) -> None:
        """Put the call into the line, at the place of the time when it was made; without a line decide it now."""
        if not self.lanes.has_line:
            call.decide()
            return
        operation = call.asked.operation
        place = self._places[call] = _Waiting(
            operation,
            call.made_s,
            call.asked.urgent,
            self.estimates.needs_server(operation),
            on_drone,
            call=call,
        )
        self.lanes.enter(place)
        self._step()

    def _step(self) -> None:
        """Have the next call in line decided, if a place is free for one.

        Raises PolicyDefect if the policy uses no lane for too long.
        """
        if self._deciding is not None or not self.lanes.line:
            self._unused_since_s = None
            return
        following = self.placement.next_in_line()
        if following is None:
            if not self.lanes.are_free or all(call.needs_server for call in self.lanes.line):
                self._unused_since_s = None
            elif self._unused_since_s is None:
                self._unused_since_s = self.now_s
            elif self.now_s >= self._unused_since_s + LONGEST_UNUSED_S:
                policy = self.selection.policy.name
                raise PolicyDefect(f"policy {policy}: place_in_line used no lane for {LONGEST_UNUSED_S:g} s")
            return
        place, where = following
        assert isinstance(place, _Waiting)  # noqa: S101 - nothing else enters
        self.lanes.leave(place)
        self.wake()  # another is first now
        self._deciding, self._unused_since_s = place.call, None
        drone_is_busy = not self.lanes.is_free(ON_DRONE)
        place.call.decide(on_drone=where == "drone", drone_is_busy=drone_is_busy)

    def take(self, call: Call, decision: Decision | None) -> None:
        """Hold the lane of the decided place, of the drone for None, until the call leaves it."""
        if self._deciding is call:
            self._deciding = None
        self.wake()
        if (holder := self._places.get(call)) is None:
            return
        place, until_s = ON_DRONE, math.inf
        if decision is not None:
            server = decision.server if isinstance(decision, Remote) and not decision.raced else None
            two = self.selection.two_answers.get(call.operation)
            computed = call.operation if two is None else two.first
            takes_s = (
                self.estimates.local_s(computed) if server is None else self.takes_s(server, call.operation)
            )
            place, until_s = name_of(server), self.now_s + (takes_s or 0.0)
        self.lanes.hold(holder, place, until_s)

    def leave(self, call: Call) -> None:
        """Free the call's place, in line or in a lane."""
        if self._deciding is call:
            self._deciding = None
        if (place := self._places.pop(call, None)) is not None:
            if place in self.lanes.line:
                self.lanes.leave(place)
            self.lanes.release(place)
        self.wake()

    def over(self, call: Call) -> None:
        """Note that the call is over."""
        self._open.remove(call)
        self.happened += 1
        self.wanted.pop(call, None)
        self._losers |= {each for each in (*call.tries, call.own) if each is not None and each.is_open}
        self.leave(call)
        if call.asked.on_servers:
            self.tell(events.CallOver(call.asked.operation))

    def _look(self) -> None:
        self._looked_s = self.now_s
        for call in list(self._open):
            if not call.is_over:
                call.look()
        self._step()

    # --- decisions ------------------------------------------------------------------------------------------

    def decided(
        self, call: Call, operation: Operation, decision: Decision, effects: Iterable[Instruction] = ()
    ) -> None:
        """Log the decision on a call, after its effects."""
        self.told += 1
        if effects := list(effects):
            self._out += [*effects, steps.LookAgain()]
        self.do(
            schema.Decided(
                waypoint=call.asked.waypoint,
                operation=str(operation),
                decision=_NAMES[type(decision)],
                server=None if isinstance(decision, Local) else decision.server,
                deadline_s=decision.deadline_s if isinstance(decision, Remote) else None,
                at_most_s=decision.at_most_s if isinstance(decision, Wait) else None,
                raced=isinstance(decision, Remote) and decision.raced,
                why=decision.why,
                position=self.here,
                **decision.inputs.facts,
            )
        )

    def is_next(self, call: Call, server: str, by_s: float) -> bool:
        """Whether the call is the next for a better answer of the server, which is free."""
        if not self.lanes.has_line:
            return True
        self.wanted[call] = by_s - (self.estimates.remote_s(server, call.asked.operation) or 0.0)
        if self._deciding is not None or not self.lanes.is_free(server):
            return False
        in_time = [wanted for wanted, latest_s in self.wanted.items() if latest_s >= self.now_s]
        first = max if self.lanes.newest_first else min
        return bool(in_time) and first(in_time, key=lambda wanted: wanted.made_s) is call

    # --- at servers -----------------------------------------------------------------------------------------

    def release(self, work: Attempt | Computing) -> None:
        """Free the lane that an attempt or a computation held."""
        self.lanes.release(work)
        self._losers.discard(work)
        self.wake()

    def takes_s(self, server: str, operation: Operation) -> float:
        """The expected seconds until a server answers a call that is sent now."""
        return self.lanes.queue_s(server, self.now_s) + (self.estimates.remote_s(server, operation) or 0.0)

    def send(self, attempt: Attempt, deadline_s: float) -> None:
        """Send the attempt's request."""
        may_queue_s = self.placement.may_queue_s(attempt.server, attempt.operation, deadline_s)
        self.do(steps.Send(attempt, deadline_s, may_queue_s))

    # --- on the drone ---------------------------------------------------------------------------------------

    def begin_own(self, own: Computing) -> None:
        """Compute on the drone, behind the earlier computations of the service."""
        self.lanes.hold(own, ON_DRONE, self.now_s + (self.estimates.local_s(own.operation) or 0.0))
        self._own[own.operation.service].append(own)
        self._compute_first(own.operation.service)

    def end_own(self, own: Computing) -> None:
        """Note that the drone has computed, or will not; the next computation of the service begins."""
        self._own[own.operation.service].remove(own)
        self._compute_first(own.operation.service)
        self.release(own)

    def _compute_first(self, service: str) -> None:
        line = self._own[service]
        if line and line[0].began_s is None:
            line[0].began_s = self.now_s
            self.do(steps.Compute(line[0], hangs_after_s(self.estimates.local_s(line[0].operation))))
