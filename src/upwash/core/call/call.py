"""The life of one call: its plan, its attempts, and the one rule that accepts an answer.

A plan says which server gets the call at once, if any, and from when on the drone computes it: `own_at_s`, or as soon
as no server is left. What servers get later, by overtaking, beside a late one or for the better of two answers, is
asked of the selection at each look.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing, End
from upwash.core.call.steps import Asked
from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import NO_INPUTS, Decision, Lightened, Local, Remote, Wait
from upwash.core.selection import events
from upwash.core.selection.hedging import Hedge
from upwash.core.selection.settings import TwoAnswers
from upwash.eventlog import schema

if TYPE_CHECKING:
    from upwash.core.call.calls import Calls

_QUEUED_S = 1.0  # until a call that only servers compute goes where it was not begun
_MOMENT_S = 0.001  # before a deadline: a timer may run early


@dataclass(slots=True, eq=False)
class Call:
    """One call of the mission, made at `made_s`. `Calls` tells it what happens, and passes on what it says."""

    asked: Asked
    made_s: float = 0.0
    is_over: bool = False
    is_waited_for: bool = False  # at rest
    is_enough: bool = False  # the mission needs no better answer, or none
    # Its decision, once its turn in line has come.
    decision: Decision | None = None
    why: str = ""
    operation: Operation = field(init=False)  # that runs: lighter than asked, perhaps
    lightened: Lightened | None = None
    decided_s: float = 0.0
    check: int = 0  # that it waits for,
    check_until_s: float = math.inf  # at most
    waited_s: float = 0.0  # for that check
    wait: Literal["", "paid off", "failed"] = ""
    is_in_line_again: bool = False  # for the drone, as a server has not begun it
    queued_s: float = 0.0  # so
    # Its attempts.
    tries: list[Attempt] = field(default_factory=list)  # the latest: at one server, or at two by a deadline
    winner: Attempt | None = None  # of these
    second_after_s: float = math.inf  # from the begin of the first, the second is due
    is_seconded: bool = False  # as far as that is possible
    second_s: float | None = None  # from the begin of the first, the second was made
    own: Computing | None = None
    own_at_s: float = math.inf
    hedge: Hedge | None = None
    is_hedged: bool = False
    is_overtaken: bool = False
    overtake_s: float = math.inf  # when a server may be of use, unless something changes before
    # With two answers.
    two: TwoAnswers | None = None
    better: Remote | None = None  # the decision for the better one, before its attempt
    has_place: bool = False  # its place in line is that server's
    no_better: bool = False  # answer comes
    has_failed: bool = False  # a server
    first_s: float | None = None  # from the call to the first answer
    has_heard: bool = False  # the mission, that answer
    # Only on servers.
    limit_s: float = math.inf
    limit_why: str = ""
    again_s: float = math.inf  # when it goes into the line again,
    again_after: int | None = None  # or when more has happened than that
    has_raised: bool = False

    def __post_init__(self) -> None:
        self.operation = self.asked.operation

    @property
    def open_tries(self) -> list[Attempt]:
        """The attempts at servers whose answers may still come."""
        return [attempt for attempt in self.tries if attempt.is_open]

    @property
    def due_s(self) -> list[float]:
        """The times at which it must be looked at, some of them over."""
        return [
            self.limit_s,
            self.again_s,
            self.check_until_s,
            self.own_at_s if self.own is None else self.overtake_s,
            self._second_at_s,
            math.inf if self.no_better else self.by_s,
        ]

    def look(self, calls: Calls) -> None:
        """Do what is due now."""
        now_s = calls.now_s
        if now_s >= self.limit_s:
            self.end_unanswered(calls)
        elif self.check:
            if now_s >= self.check_until_s or not calls.selection.is_awaited(self.check):
                self._decide_after_wait(calls)
        elif now_s >= self.again_s or (self.again_after is not None and calls.happened > self.again_after):
            self._enter_again(calls)
        elif self.two is not None:
            self._seek_better(calls)
            if self.own is None and (now_s >= self.own_at_s or self.no_better):
                self._compute(calls, self.two.first)
            self._end_twice(calls)
        elif self.own is None:
            if now_s >= self._second_at_s:
                self._is_tried_elsewhere(calls)
            if now_s >= self.own_at_s and calls.lanes.is_free(ON_DRONE):
                self._compute_hedged(calls)
        elif self.own.is_open and not self.open_tries:
            self._be_overtaken(calls, self.own)
        elif now_s >= self._second_at_s:
            self._is_tried_elsewhere(calls)

    # --- its place ------------------------------------------------------------------------------------------

    def decide(self, calls: Calls, *, on_drone: bool = False, drone_is_busy: bool = False) -> None:
        """Decide where the call runs, now that its turn has come, and begin the first attempts."""
        if self.is_in_line_again:
            calls.take(self, Local("the server has not begun it"))
            self.queued_s = calls.now_s - self.queued_s
            self._fall_back(calls)
            return
        self.decided_s = calls.now_s
        if self.asked.once:
            calls.take(self, None)
            self.why = "it runs once, and on the drone"
            self._compute(calls, self.operation)
            return
        decision = calls.decide(self, on_drone=on_drone, drone_is_busy=drone_is_busy)
        self.why, self.lightened = decision.why, decision.inputs.lightened
        if self.lightened is not None:
            self.operation = self.lightened.operation
        self.two = calls.selection.two_answers.get(self.operation)
        if self.asked.on_servers and not isinstance(decision, Remote):
            calls.leave(self)
            self.again_after = calls.happened  # what the policy thinks of this server may change then
        elif isinstance(decision, Wait) and self.two is None:
            self.check = calls.selection.servers[decision.server].check
            self.check_until_s = calls.now_s + decision.at_most_s
        else:
            self._place(calls, decision)

    def _decide_after_wait(self, calls: Calls) -> None:
        check, self.check, self.check_until_s = self.check, 0, math.inf
        decision = calls.decide_after_wait(self, check)
        self.wait = "paid off" if isinstance(decision, Remote) else "failed"
        self.why = f"{self.why}: {decision.why}"
        self.waited_s = calls.now_s - self.decided_s
        self._place(calls, decision)

    def _place(self, calls: Calls, decision: Decision) -> None:
        """Take the lane of the decided place, and begin what the plan begins at once."""
        self.decision, now_s = decision, calls.now_s
        calls.take(self, decision)
        if self.asked.on_servers:
            assert isinstance(decision, Remote)  # noqa: S101 - else it goes on waiting for a server
            self._try(calls, decision)
            return
        calls.hedging.called(self.operation)
        if self.two is not None:
            self._place_twice(calls, decision, self.two)
            return
        calls.deadlines.called(self.operation)
        if not isinstance(decision, Remote):
            self._compute(calls, self.operation)
        elif decision.raced:
            self._try(calls, decision)
            self._compute(calls, self.operation)
        else:
            within_s = calls.deadlines.within_s(self.operation)
            self.hedge = calls.hedging.plan(
                decision, self.operation, is_busy=calls.is_busy, within_s=within_s
            )
            if self.hedge is not None:
                self.own_at_s = now_s + self.hedge.after_s
                decision = replace(decision, deadline_s=self.hedge.deadline_s)
            self._try(calls, decision)

    def _place_twice(self, calls: Calls, decision: Decision, two: TwoAnswers) -> None:
        if isinstance(decision, Remote):
            self.better = decision
            if not decision.raced:  # it is expected before the first one
                self.has_place = True
                hedge = calls.hedging.plan(decision, two.first, is_busy=False)
                self.own_at_s = calls.now_s + (hedge.after_s if hedge else decision.deadline_s)
        self._seek_better(calls)
        if self.own_at_s == math.inf:
            self._compute(calls, two.first)

    # --- at servers -----------------------------------------------------------------------------------------

    def _try(self, calls: Calls, remote: Remote) -> None:
        """Attempt the call at a server, and plan when a second one gets it too."""
        self.tries, self.winner, self.is_seconded, self.second_s = [], None, False, None
        self._begin(calls, remote)
        if not self.asked.on_servers:
            self.second_after_s = calls.second_after_s(self.tries[0].operation, remote.server)

    def _begin(self, calls: Calls, remote: Remote) -> None:
        operation, lightened = self.operation, self.lightened
        if self.own is not None and self.two is None:  # which it overtakes
            operation, lightened = self.own.operation, self.own.lightened
        attempt = Attempt(
            self,
            remote.server,
            calls.selection.servers[remote.server].check,
            operation,
            lightened,
            calls.here,
            remote.inputs,
            remote.deadline_s,
            calls.now_s,
            calls.now_s,
            self.asked.size_bytes(operation),
            remote.inputs.sends_less,
        )
        self.tries.append(attempt)
        calls.hold_server(attempt)
        if attempt.sends_less:
            calls.do(steps.Reduce(attempt))
        else:
            calls.send(attempt, attempt.deadline_s)

    def reduced(self, calls: Calls, event: steps.Reduced) -> None:
        """Send what the part before sending has left, if the server is still of use."""
        attempt = event.attempt
        attempt.part_s, attempt.sent_bytes = calls.now_s - attempt.begun_s, event.size_bytes
        attempt.sends_less = event.is_less
        if event.why:
            calls.part_failed(attempt.operation, event.why)
        left_s, expected_s = attempt.deadline_s - attempt.part_s, 0.0
        if not attempt.sends_less:
            attempt.counts_from_s = calls.now_s
            expected_s = calls.estimates.remote_s(attempt.server, attempt.operation) or 0.0
        may_send = not self.is_over and calls.placement.may_send(attempt.server, attempt.check)
        if may_send and expected_s <= left_s:
            calls.send(attempt, left_s)
        else:
            self.ended(calls, attempt, "failed")

    def is_late(self, attempt: Attempt) -> bool:
        """Whether the mission had another answer before."""
        return self.is_over or self.has_heard or self.winner not in (None, attempt)

    def ended(self, calls: Calls, attempt: Attempt, state: End) -> None:
        """Accept the answer of an attempt, or go on without one."""
        attempt.state = state
        calls.release(attempt)
        if self.is_over or self.winner is not None:
            return
        if attempt.settles:
            self.winner = attempt
        if state == "answered":
            self._end(calls, attempt)
        elif self.two is not None:
            self._go_on_twice(calls, attempt, self.two)
        elif self.asked.on_servers:
            self._go_on_at_servers(calls, attempt)
        elif state != "raised" and self._is_tried_elsewhere(calls):
            return
        elif self.own is None:
            if state == "queued" and calls.lanes.has_line and self.second_after_s == math.inf:
                self.queued_s, self.is_in_line_again = calls.now_s, True
                calls.leave(self)
                calls.enter(self, on_drone=True)
            else:
                self._fall_back(calls)
        elif self.own.state == "failed":
            self._go_on_without_own(calls, self.own)

    @property
    def _second_at_s(self) -> float:
        if not self.open_tries or self.is_seconded:
            return math.inf
        return self.tries[0].begun_s + self.second_after_s

    def _is_tried_elsewhere(self, calls: Calls) -> bool:
        """Whether the other try goes on, or begins now."""
        if self.second_after_s < math.inf and not self.is_seconded:
            self._ask_second(calls, self.tries[0])
        return bool(self.open_tries)

    def _ask_second(self, calls: Calls, first: Attempt) -> None:
        """Send the call to another READY server too, in the time that is left, if one may get it."""
        self.is_seconded, after_s = True, calls.now_s - first.begun_s
        left_s = first.deadline_s - after_s
        server = calls.second(first) if left_s > 0 else None
        if server is None:
            return
        self.second_s = after_s
        calls.do(
            schema.Seconded(
                waypoint=self.asked.waypoint,
                operation=str(first.operation),
                server=first.server,
                second=server,
                check=calls.selection.servers[server].check,
                after_s=after_s,
                deadline_s=left_s,
            )
        )
        self._begin(calls, Remote(server, left_s, f"{first.server} is late"))

    def _be_overtaken(self, calls: Calls, own: Computing) -> None:
        """Attempt the call at a server that would answer before the drone, which computes it."""
        if self.asked.once or (self.winner is not None and self.winner.raised):
            return
        began_s = calls.now_s if own.began_s is None else own.began_s
        remote, self.overtake_s = calls.overtake(self, own.operation, began_s)
        if remote is not None:
            self.is_overtaken = True
            self._try(calls, remote)

    # --- on the drone ---------------------------------------------------------------------------------------

    def _compute(self, calls: Calls, operation: Operation, lightened: Lightened | None = None) -> None:
        self.own = Computing(self, operation, lightened or self.lightened, calls.now_s)
        calls.begin_own(self.own)

    def _compute_hedged(self, calls: Calls) -> None:
        assert self.hedge is not None  # noqa: S101 - only a hedge sets a time
        self.is_hedged, first = True, self.tries[0]
        calls.do(
            schema.Hedged(
                waypoint=self.asked.waypoint,
                server=first.server,
                check=first.check,
                after_s=self.hedge.after_s,
                deadline_s=self.hedge.deadline_s,
            )
        )
        self._compute(calls, self.operation)

    def _fall_back(self, calls: Calls) -> None:
        """Compute on the drone: after a reported exception the same call, to test it; else perhaps a lighter one."""
        lightened = None
        if self.winner is None and self.lightened is None:
            lightened = calls.selection.fall_back(self.operation, now_s=calls.now_s, position=calls.here)
        self._compute(calls, lightened.operation if lightened else self.operation, lightened)

    def computed(self, calls: Calls, event: steps.Computed) -> None:
        """Accept the drone's own answer, or go on without one."""
        own = event.computing
        own.state, own.raised = "failed" if event.failed else "answered", event.raised
        calls.end_own(own)
        if self.is_over:
            calls.do(schema.Dropped(operation=str(own.operation), place=ON_DRONE))
        elif self.two is not None:
            if not self.has_place:
                calls.leave(self)
            if not event.failed:
                calls.computed(own, asked=self.operation)
                self.first_s = calls.now_s - self.made_s
                self.has_heard = not event.raised
                if self.has_heard:
                    calls.do(steps.Hear(own, self.first_s))
            self._end_twice(calls)
        elif not event.failed:
            if self.winner is not None:
                calls.test(self.winner, raised=bool(event.raised))
            if not self.asked.once:
                calls.computed(own)
            self._end(calls, own)
        else:
            self._go_on_without_own(calls, own)

    def _go_on_without_own(self, calls: Calls, own: Computing) -> None:
        """End the call with the drone's failure, unless another server may still answer it."""
        self.winner = None  # the drone cannot test an exception that a server has reported
        if not self.open_tries:
            self._end(calls, own)

    # --- with two answers -----------------------------------------------------------------------------------

    @property
    def by_s(self) -> float:
        """When the better of two answers is too late."""
        return self.made_s + (self.two.within_s if self.two is not None else math.inf)

    def _seek_better(self, calls: Calls) -> None:
        """Attempt the call at a server that can give the better answer in time, or give that up."""
        if self.no_better or self.open_tries:
            return
        remote, self.better = self.better, None
        left_s = self.by_s - calls.now_s
        if (
            remote is None
            or left_s <= _MOMENT_S
            or not (self.has_place or calls.is_next(self, remote.server))
        ):
            remote = self._sought(calls)
        if remote is None:
            return
        calls.sends_better(self)
        self.tries, self.winner = [], None
        holds_place, self.has_place = self.has_place, False
        self._begin(calls, replace(remote, deadline_s=min(remote.deadline_s, left_s)))
        self.tries[0].holds_place = holds_place

    def _sought(self, calls: Calls) -> Remote | None:
        if self.by_s - calls.now_s <= _MOMENT_S or self.is_enough:
            self.no_better = True
            return None
        server = calls.selection.current
        is_next = server is not None and calls.is_next(self, server.name)
        remote, may_come = calls.better(self, is_next=is_next)
        self.no_better = remote is None and self.is_waited_for and not may_come
        return remote

    def _go_on_twice(self, calls: Calls, attempt: Attempt, two: TwoAnswers) -> None:
        if attempt.holds_place:
            calls.leave(self)
        self.has_failed, self.no_better = True, bool(attempt.raised)
        self._seek_better(calls)
        if self.own is None:
            self._compute(calls, two.first)
        self._end_twice(calls)

    def _end_twice(self, calls: Calls) -> None:
        """End the call with the first answer, or its failure, if no better one comes."""
        if self.is_over or self.own is None or self.own.is_open:
            return
        if self.no_better or self.is_enough:
            self._end(calls, self.own)

    # --- only on servers ------------------------------------------------------------------------------------

    def _go_on_at_servers(self, calls: Calls, attempt: Attempt) -> None:
        if attempt.state == "queued":
            self.again_s = calls.now_s + _QUEUED_S
            return
        if attempt.raised:
            why = f"{attempt.server} says that {attempt.operation} raised {attempt.raised}"
            if attempt.sends_less:  # which may be the fault of what was sent
                calls.part_failed(attempt.operation, why)
                if calls.placement.may_send(attempt.server, attempt.check):
                    inputs = attempt.inputs
                    longer = (inputs.whole_s or 1.0) / (inputs.less_s or 1.0)
                    self._try(
                        calls, Remote(attempt.server, longer * attempt.deadline_s, "", inputs=NO_INPUTS)
                    )
                    return
            else:
                calls.blame(attempt, why, confirmed=self.has_raised)
                if self.has_raised:
                    self.limit_why = f"{why}, as at the attempt before"
                    self.end_unanswered(calls)
                    return
                self.has_raised = True
        self._enter_again(calls)

    def _enter_again(self, calls: Calls) -> None:
        self.again_s, self.again_after = math.inf, None
        calls.leave(self)
        calls.tell(events.CallWaits(self.asked.operation, again=True))
        calls.enter(self)

    def limit(self, calls: Calls, why: str, *, in_s: float = 0.0) -> None:
        """End the call without an answer after that time, unless it ends before."""
        if (until_s := calls.now_s + in_s) < self.limit_s:
            self.limit_s, self.limit_why = until_s, why
            calls.wake()

    def end_unanswered(self, calls: Calls) -> None:
        """End a call that only servers compute."""
        within_s = self.asked.within_s
        why = self.limit_why or f"no server answered within {within_s:g} s"
        self._stop(calls)
        calls.over(self)
        calls.do(
            schema.Unanswered(
                waypoint=self.asked.waypoint,
                operation=str(self.asked.operation),
                at_s=self.made_s,
                waited_s=calls.now_s - self.made_s,
                within_s=within_s,
                why=why,
            )
        )
        calls.do(steps.NoAnswer(self, why))

    # --- its end --------------------------------------------------------------------------------------------

    def abandon(self, calls: Calls) -> None:
        """Drop all that is under way for it."""
        self._stop(calls)
        calls.over(self)

    def _stop(self, calls: Calls) -> None:
        self.is_over = True
        for attempt in self.open_tries:
            attempt.state = "failed"
            calls.release(attempt)
            calls.do(steps.Stop(attempt))
        if self.own is not None and self.own.is_open:
            self.own.state = "failed"
            calls.forget_own(self.own)

    def _end(self, calls: Calls, source: Attempt | Computing) -> None:
        self.is_over = True
        if source.state == "answered":
            calls.do(self._record(calls, source))
        calls.do(steps.Answer(self, source))
        own = self.own
        if own is not None and own is not source:
            self._count_hedge(calls, own)
            if own.is_open and own.began_s is None:
                calls.forget_own(own)  # it was still in line
            elif own.state == "failed":
                calls.do(schema.Dropped(operation=str(own.operation), place=ON_DRONE))
        calls.over(self)

    def _count_hedge(self, calls: Calls, own: Computing) -> None:
        """Count the drone's work on a hedged call that its server has answered after all."""
        decision, winner = self.decision, self.winner
        if not self.is_hedged or self.hedge is None or winner is None or not isinstance(decision, Remote):
            return
        if winner.server == decision.server:
            onboard_s = 0.0 if own.began_s is None else calls.now_s - own.began_s
            calls.hedging.overtaken(self.hedge, decision, self.operation, onboard_s=onboard_s)

    def _record(self, calls: Calls, source: Attempt | Computing) -> schema.Call:
        own, now_s = self.own, calls.now_s
        attempt = source if isinstance(source, Attempt) else None
        onboard_s = queued_s = 0.0
        if own is not None and (own is source or own.is_open or self.two is None):
            began_s = now_s if own.began_s is None else own.began_s
            onboard_s, queued_s = now_s - began_s, began_s - own.asked_s + self.queued_s
        if own is not None and own.state == "answered":
            onboard_s = own.took_s
        return schema.Call(
            waypoint=self.asked.waypoint,
            operation=str(source.operation),
            place=name_of(attempt.server if attempt else None),
            check=attempt.check if attempt else None,
            decision=self.why + self._said(attempt) + (attempt.told_of_sending if attempt else ""),
            at_s=self.made_s,
            delay_s=now_s - self.made_s,
            waited_s=self.waited_s,
            onboard_s=onboard_s,
            wait=self.wait,
            fell_back=attempt is None and self._fell_back,
            hedged_s=self.hedge.after_s if self.is_hedged and self.hedge else None,
            second_s=self.second_s if attempt else None,
            queued_s=self.decided_s - self.made_s + queued_s or None,
            remote_fault=self._verdict if attempt is None else "",
            first_s=self.first_s,
            **(attempt.facts_of_sending if attempt else {}),
            **self._asked_for(source),
        )

    def _asked_for(self, source: Attempt | Computing) -> dict[str, Any]:
        if self.two is not None and isinstance(source, Computing):
            return {"asked": str(self.operation)}
        return source.lightened.facts if source.lightened else {}

    @property
    def _fell_back(self) -> bool:
        """Whether the drone computed it because servers failed."""
        return self.has_failed if self.two is not None else bool(self.tries) and not self.open_tries

    @property
    def _verdict(self) -> Literal["", "confirmed", "denied"]:
        return self.winner.verdict if self.winner is not None else ""

    def _said(self, attempt: Attempt | None) -> str:
        """What has become of the decision, after a semicolon."""
        if self.two is not None:
            if attempt is None:
                return "; the first answer counts, as no better one came"
            return "" if self.first_s is None else f"; the better answer, of {attempt.server}"
        if attempt is not None:
            return f"; {attempt.server} became of use, and was sooner" if self.is_overtaken else ""
        if not isinstance(self.decision, Remote):
            return ""
        if self._verdict:
            return f"; it raised there, which was {self._verdict} on the drone"
        return f"; {'no usable answer, so' if self._fell_back else 'late, and sooner'} on the drone"
