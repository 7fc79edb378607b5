"""All calls of one drone: the line in which they wait, the drone's own computer, and what is learnt of servers.

    in line         where several calls may be open. The oldest is first, or the newest, as configured; a call that
                    the mission waits for is before all others, and one that only servers compute before those that
                    the drone could compute
    its place       the policy chooses it. By default a free place takes the first call that it would answer before
                    the other place gets to it (core/planning/earliest.py). The drone takes a call that runs once
    decided         once its place is free; then the next call is decided
    on the drone    the computations of a service run one after the other

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
from upwash.core.call.attempts import Attempt, Computing
from upwash.core.call.call import Call
from upwash.core.call.steps import CallEvent, Instruction, MissionEvent
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
_LEAST_S, _FACTOR = (
    10.0,
    3.0,
)  # times the expected delay: a server in range has that time where the mission waits
_LOCAL_LEAST_S, _LOCAL_FACTOR = 30.0, 10.0  # times the estimate: a local call that takes longer hangs
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
        self.now_s, self.here = 0.0, Position(0.0, 0.0)
        self.news = 0  # how often something has changed that calls may wait for
        self.happened = 0  # how many events were taken in, and calls have ended
        self.told = 0  # how often the selection has learnt or decided something
        self._waiting_bytes = waiting_bytes
        self._looked_s = -math.inf
        self._out: list[Instruction] = []
        self._open: list[Call] = []
        self._losers: set[Attempt | Computing] = set()  # that go on after their calls were answered
        self._own = defaultdict[str, deque[Computing]](deque)  # of each service; the first runs
        self._places: dict[Call, _Waiting] = {}  # in line, or the holder of a lane
        self._deciding: Call | None = None
        self._wanted: dict[Call, float] = {}  # calls for a better answer, and by when each must be sent
        self._unused_since_s: float | None = None  # both lanes, beside calls that the drone could compute

    def handle(
        self, event: CallEvent | SelectionEvent, *, now_s: float, position: Position
    ) -> list[Instruction]:
        """Take in what has happened at the position; return what the program has to do, in that order."""
        self.now_s, self.here = now_s, position
        self.selection.locate(position, now_s)
        self.happened += not isinstance(event, steps.News)
        self._take_in(event)
        out, self._out = self._out, []
        return out

    def _take_in(self, event: CallEvent | SelectionEvent) -> None:
        match event:
            case SelectionEvent():
                self.tell(event)
            case steps.News():
                self._look()
            case steps.Replied():
                self._replied(event)
            case steps.NotBegun():
                self._not_begun(event)
            case steps.SlotLost(attempt, why):
                self.tell(events.SlotTaken(attempt.check, why, in_call=True))
                attempt.call.ended(self, attempt, "failed")
            case steps.Failed():
                self._failed(event)
            case steps.Reduced(attempt):
                attempt.call.reduced(self, event)
            case steps.Computed(computing):
                computing.call.computed(self, event)
            case _:
                self._hear(event)

    def _hear(self, event: MissionEvent) -> None:
        match event:
            case steps.Made(call):
                self._make(call)
            case steps.Waited(call):
                call.is_waited_for = True
                self._hurry(call)
            case steps.Enough(call):
                call.is_enough = True
                if call.asked.on_servers:
                    call.limit(self, "the mission dropped it")
                self.wake()
            case steps.Abandoned(call):
                call.abandon(self)
            case steps.EndWaiting(why):
                for call in self.waiting:
                    call.limit(self, why)

    @property
    def due_s(self) -> float:
        """When `News` must be handled, unless something happens before; over, if an event came first at that time."""
        times_s = [due_s for call in self._open for due_s in call.due_s]
        if self._unused_since_s is not None:
            times_s.append(self._unused_since_s + LONGEST_UNUSED_S)
        return min((due_s for due_s in times_s if due_s > self._looked_s), default=math.inf)

    @property
    def waiting(self) -> list[Call]:
        """The open calls that only servers compute, the oldest first."""
        return [call for call in self._open if call.asked.on_servers]

    @property
    def is_busy(self) -> bool:
        """Whether the drone, or what is left of an answered call, computes something."""
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
        call.made_s = self.now_s
        self._open.append(call)
        if call.asked.on_servers:
            self._begin_waiting(call)
        self.enter(call, on_drone=call.asked.once)
        if call.asked.on_servers and call.is_waited_for:
            self._hurry(call)

    def enter(self, call: Call, *, on_drone: bool = False) -> None:
        """Put the call into the line, at the place of the time when it was made; without a line decide it now."""
        if not self.lanes.has_line:
            call.decide(self)
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
        """Have the next call in line decided, if a place is free for one."""
        if self._deciding is not None or not self.lanes.line:
            self._unused_since_s = None
            return
        following = self.placement.next_in_line(self.now_s)
        if following is None:
            self._watch_unused()
            return
        place, where = following
        assert isinstance(place, _Waiting)  # noqa: S101 - nothing else enters
        self.lanes.leave(place)
        self.wake()  # another is first now
        self._deciding, self._unused_since_s = place.call, None
        drone_is_busy = not self.lanes.is_free(ON_DRONE)
        place.call.decide(self, on_drone=where == "drone", drone_is_busy=drone_is_busy)

    def _watch_unused(self) -> None:
        """Raise PolicyDefect if the policy uses no lane for too long."""
        if not self.lanes.are_free or all(call.needs_server for call in self.lanes.line):
            self._unused_since_s = None
        elif self._unused_since_s is None:
            self._unused_since_s = self.now_s
        elif self.now_s >= self._unused_since_s + LONGEST_UNUSED_S:
            policy = self.selection.policy.name
            raise PolicyDefect(f"policy {policy}: place_in_line used no lane for {LONGEST_UNUSED_S:g} s")

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
                self.estimates.local_s(computed) if server is None else self._takes_s(server, call.operation)
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
        self._wanted.pop(call, None)
        self._losers |= {each for each in (*call.tries, call.own) if each is not None and each.is_open}
        self.leave(call)
        if call.asked.on_servers:
            self.tell(events.CallOver(call.asked.operation))

    def _look(self) -> None:
        self._looked_s = self.now_s
        for call in list(self._open):
            if not call.is_over:
                call.look(self)
        self._step()

    # --- decisions ------------------------------------------------------------------------------------------

    def decide(self, call: Call, *, on_drone: bool, drone_is_busy: bool) -> Decision:
        """Where the call runs, and whether lighter; logged."""
        decision, effects = self.selection.decide(
            call.asked.operation,
            now_s=self.now_s,
            position=self.here,
            on_drone=on_drone,
            drone_is_busy=drone_is_busy,
        )
        lightened = decision.inputs.lightened
        return self._decided(
            call, lightened.operation if lightened else call.asked.operation, decision, effects
        )

    def decide_after_wait(self, call: Call, check: int) -> Decision:
        """Where the call runs after its wait for that check; logged."""
        decision, effects = self.selection.decide_after_wait(
            call.operation, check, now_s=self.now_s, position=self.here
        )
        return self._decided(call, call.operation, decision, effects)

    def overtake(self, call: Call, operation: Operation, began_s: float) -> tuple[Remote | None, float]:
        """The READY server expected to answer before the drone, logged, or None; and when to ask again."""
        remote, again_s = self.selection.overtake(
            operation, began_s=began_s, now_s=self.now_s, position=self.here
        )
        if remote is not None:
            self._decided(call, operation, remote)
        return remote, again_s

    def better(self, call: Call, *, is_next: bool) -> tuple[Remote | None, bool]:
        """The server for the call's better answer, logged, or None; and whether one may become of use in time."""
        remote, may_come = self.placement.better(call.operation, call.by_s, self.now_s, is_next=is_next)
        if remote is not None:
            self._decided(call, call.operation, remote)
        return remote, may_come

    def _decided(
        self, call: Call, operation: Operation, decision: Decision, effects: Iterable[Instruction] = ()
    ) -> Decision:
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
        return decision

    def second_after_s(self, operation: Operation, server: str) -> float:
        """The seconds after which a second server gets a call that this one has not answered; infinite for none."""
        if self.deadlines.within_s(operation) is None:
            return math.inf
        second = self.placement.second(operation, server, self.now_s, begins=False)
        plan = self.deadlines.prospect(operation, server, None if second is None else second.name)
        return math.inf if plan is None or plan.after_s is None else plan.after_s

    def second(self, first: Attempt) -> str | None:
        """The server that gets a call beside the first attempt, as counted; None if none may get it."""
        if not self.deadlines.may_ask(first.operation):
            return None
        server = self.placement.second(first.operation, first.server, self.now_s, begins=True)
        if server is None:
            return None
        self.deadlines.asked(first.operation)
        return server.name

    def is_next(self, call: Call, server: str) -> bool:
        """Whether the call is the next for a better answer of the server, which is free."""
        if not self.lanes.has_line:
            return True
        self._wanted[call] = call.by_s - (self.estimates.remote_s(server, call.asked.operation) or 0.0)
        if self._deciding is not None or not self.lanes.is_free(server):
            return False
        in_time = [wanted for wanted, latest_s in self._wanted.items() if latest_s >= self.now_s]
        first = max if self.lanes.newest_first else min
        return bool(in_time) and first(in_time, key=lambda wanted: wanted.made_s) is call

    def sends_better(self, call: Call) -> None:
        """Note that the call is sent for its better answer."""
        self._wanted.pop(call, None)

    # --- at servers -----------------------------------------------------------------------------------------

    def hold_server(self, attempt: Attempt) -> None:
        """Hold the lane of the attempt's server until it is over."""
        takes_s = self._takes_s(attempt.server, attempt.operation)
        self.lanes.hold(attempt, attempt.server, self.now_s + takes_s)

    def release(self, work: Attempt | Computing) -> None:
        """Free the lane that an attempt or a computation held."""
        self.lanes.release(work)
        self._losers.discard(work)
        self.wake()

    def _takes_s(self, server: str, operation: Operation) -> float:
        return self.lanes.queue_s(server, self.now_s) + (self.estimates.remote_s(server, operation) or 0.0)

    def send(self, attempt: Attempt, deadline_s: float) -> None:
        """Send the attempt's request."""
        may_queue_s = self.placement.may_queue_s(attempt.server, attempt.operation, deadline_s, self.now_s)
        self.do(steps.Send(attempt, deadline_s, may_queue_s))

    def _replied(self, reply: steps.Replied) -> None:
        attempt = reply.attempt
        call, delay_s = attempt.call, self.now_s - attempt.counts_from_s
        if reply.raised:
            attempt.raised, attempt.delay_s = reply.raised, delay_s
            self._doubt(attempt)
            self._reached(attempt, delay_s, reply.size_bytes)
            call.ended(self, attempt, "raised")
            return
        is_late, less = call.is_late(attempt), attempt.sends_less
        if is_late and (call.two is None or call.is_over):
            self.do(schema.Dropped(operation=str(attempt.operation), place=attempt.server))
        self.deadlines.answered(attempt.server, attempt.operation, delay_s)
        self.hedging.answered(attempt.server, attempt.operation, delay_s, less=less)
        self.tell(
            events.RemoteCallEnded(
                attempt.server,
                attempt.operation,
                delay_s,
                is_late,
                less,
                min(reply.queued_s, delay_s),
                reply.queue_s,
            )
        )
        self._reached(attempt, delay_s, reply.size_bytes)
        call.ended(self, attempt, "answered")

    def _not_begun(self, event: steps.NotBegun) -> None:
        attempt, why, queue_s = event.attempt, event.why, event.queue_s
        waited_s = self.now_s - attempt.counts_from_s
        self.do(
            schema.RemoteQueued(
                waypoint=attempt.call.asked.waypoint,
                server=attempt.server,
                check=attempt.check,
                waited_s=waited_s,
                queue_s=queue_s,
                why=why,
            )
        )
        is_late = attempt.call.is_late(attempt)
        self.tell(events.RemoteCallQueued(attempt.server, why, waited_s, queue_s, is_late))
        attempt.call.ended(self, attempt, "queued")

    def _failed(self, failure: steps.Failed) -> None:
        attempt, why = failure.attempt, failure.why
        delay_s = self.now_s - attempt.counts_from_s
        self.do(schema.RemoteFailed(server=attempt.server, check=attempt.check, why=why))
        if failure.cut:
            cut = events.RemoteCallCut(attempt.server, attempt.operation, delay_s, attempt.sends_less)
            self.do(steps.Cut(attempt, cut))
        self._call_failed(attempt, why)
        self.deadlines.answered(attempt.server, attempt.operation, math.inf)
        if failure.unreached:
            self._reached(attempt, delay_s, None)
        attempt.call.ended(self, attempt, "failed")

    def _call_failed(self, attempt: Attempt, why: str) -> None:
        is_late = attempt.call.is_late(attempt)
        self.tell(events.RemoteCallFailed(attempt.server, attempt.check, why, is_late))

    def _reached(self, attempt: Attempt, delay_s: float, answer_bytes: int | None) -> None:
        """Tell the selection how fast the server answered at this place, for a server without a range."""
        if self.estimates.is_measured(attempt.server):
            self.tell(
                events.Reached(
                    attempt.server,
                    attempt.position,
                    answer_bytes is not None,
                    attempt.operation,
                    delay_s,
                    (attempt.sent_bytes or attempt.size_bytes) + (answer_bytes or 0),
                    attempt.sends_less,
                )
            )

    def part_failed(self, operation: Operation, why: str) -> None:
        """Note that the part before sending failed, or is to blame."""
        self.tell(events.PartFailed(operation.service))
        again = self.estimates.tries_part(operation.service)
        self.do(schema.SentWhole(operation=str(operation), why=why, given_up=not again))

    # --- exceptions that servers report ---------------------------------------------------------------------

    def _doubt(self, attempt: Attempt) -> None:
        """Log the exception; the mission only gets exceptions of the drone's own service, where there is one."""
        call, operation = attempt.call, attempt.operation
        why = f"{attempt.server} says that {operation} raised {attempt.raised}"
        if call.asked.on_servers:  # the drone cannot test it
            self.do(schema.RemoteFailed(server=attempt.server, check=attempt.check, why=why))
            return
        self.do(
            schema.RemoteRaised(
                server=attempt.server, check=attempt.check, operation=str(operation), raised=attempt.raised
            )
        )
        if call.two is not None:  # the drone computes another operation, which tests nothing
            if attempt.sends_less:  # which may be the fault of what was sent
                self.part_failed(operation, why)
            else:
                self._call_failed(attempt, why)
        elif not call.is_late(attempt):
            self.tell(events.RemoteCallRaised(attempt.server, why))
        elif call.own is not None and call.own.state == "answered" and call.winner is None:
            self.test(attempt, raised=bool(call.own.raised))
        else:  # another server answered
            self._call_failed(attempt, why)

    def test(self, attempt: Attempt, *, raised: bool) -> None:
        """Compare the exception that the server reported with the drone's own result of the same call."""
        operation, confirmed = attempt.operation, raised
        attempt.verdict = "confirmed" if confirmed else "denied"
        why = f"it says that {operation} raised {attempt.raised}, which did not raise on the drone"
        if confirmed:
            self.hedging.answered(attempt.server, operation, attempt.delay_s, less=attempt.sends_less)
        elif attempt.sends_less:  # which may be the fault of what was sent
            self.part_failed(operation, f"{attempt.server} says that it raised {attempt.raised} then")
            return
        else:
            self.do(steps.Deny(attempt))
            self.do(
                schema.RemoteFailed(
                    server=attempt.server, check=attempt.check, why=f"{attempt.server}: {why}"
                )
            )
        self.blame(attempt, why, confirmed=confirmed)

    def blame(self, attempt: Attempt, why: str, *, confirmed: bool) -> None:
        """Tell the selection whether an exception that a server reported is the call's own, or the server's fault."""
        self.tell(
            events.RemoteFaultTested(
                attempt.server,
                attempt.check,
                attempt.operation,
                attempt.delay_s,
                why,
                confirmed,
                attempt.sends_less,
            )
        )

    # --- on the drone ---------------------------------------------------------------------------------------

    def begin_own(self, own: Computing) -> None:
        """Compute on the drone, behind the earlier computations of the service."""
        self.lanes.hold(own, ON_DRONE, self.now_s + (self.estimates.local_s(own.operation) or 0.0))
        line = self._own[own.operation.service]
        line.append(own)
        if line[0] is own:
            self._begin_computing(own)

    def _begin_computing(self, own: Computing) -> None:
        own.began_s = self.now_s
        expected_s = self.estimates.local_s(own.operation) or 0.0
        self.do(steps.Compute(own, max(_LOCAL_LEAST_S, _LOCAL_FACTOR * expected_s)))

    def end_own(self, own: Computing) -> None:
        """Note that the drone has computed; the next computation of the service begins."""
        own.took_s = self.now_s - (own.began_s or 0.0)
        self._leave_own(own)

    def forget_own(self, own: Computing) -> None:
        """Drop a computation."""
        if own.began_s is not None:
            self.do(steps.Stop(own))
        self._leave_own(own)

    def _leave_own(self, own: Computing) -> None:
        line = self._own[own.operation.service]
        line.remove(own)
        if line and line[0].began_s is None:
            self._begin_computing(line[0])
        self.release(own)

    def computed(self, own: Computing, asked: Operation | None = None) -> None:
        """Tell the selection how long the drone took; `asked` for the first of two answers."""
        self.tell(events.LocalCallEnded(own.operation, own.took_s, asked))

    # --- only on servers ------------------------------------------------------------------------------------

    def _begin_waiting(self, call: Call) -> None:
        operation, within_s = call.asked.operation, call.asked.within_s
        call.limit_s = math.inf if within_s is None else self.now_s + within_s
        self.tell(events.CallWaits(operation))
        most_bytes = self._waiting_bytes[operation.service]
        its = [each for each in self.waiting if each.asked.operation.service == operation.service]
        sizes = [each.asked.size_bytes(each.asked.operation) for each in its]
        over_bytes = sum(sizes) - most_bytes
        for each, size_bytes in zip(its, sizes, strict=True):
            if over_bytes <= 0:
                return
            why = f"calls that wait for a server keep more than service.waiting_bytes = {most_bytes}"
            each.limit(self, why)
            over_bytes -= size_bytes

    def _hurry(self, call: Call) -> None:
        """The mission waits for the call: without a deadline it waits only while a server in range can answer."""
        self.wake()
        if not call.asked.on_servers or call.limit_s < math.inf:
            return
        reach_s = self.selection.planning.reach_s(call.asked.operation, self.now_s, self.here)
        if reach_s is None:
            call.limit(self, "no server in range can answer, and the mission waits")
        else:
            limit_s = max(_LEAST_S, _FACTOR * reach_s * len(self.waiting))
            call.limit(self, f"no server in range answered within {limit_s:.0f} s", in_s=limit_s)
