"""Calls with one answer: the drone, a server, or several places compute the call, and the first answer counts.

local       The drone computes. A server that becomes READY meanwhile gets the call too.
remote      A server computes, and the drone once the server has failed.
hedged      A server computes. The drone joins a late server (core/selection/hedging.py).
raced       A server on trial and the drone compute at once.
seconded    A second server joins a late server by a deadline (core/selection/deadlines.py).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from upwash.core.call.attempts import Attempt, Computing
from upwash.core.call.manner import Manner
from upwash.core.operation import ON_DRONE
from upwash.core.policies.policy import Decision, Local, Remote
from upwash.core.selection import events
from upwash.core.selection.hedging import Hedge
from upwash.eventlog import schema

if TYPE_CHECKING:
    from upwash.core.call.call import Call


class Single(Manner):
    """A call with one answer, the first that comes."""

    may_wait = True

    def __init__(self, call: Call) -> None:
        super().__init__(call)
        self._second_after_s = math.inf  # from the begin of the first try
        self._is_seconded = False  # as far as that is possible
        self._second_s: float | None = None  # from the begin of the first try, where the second was made
        self._hedge: Hedge | None = None
        self._own_at_s = math.inf
        self._is_overtaken = False
        self._overtake_s = math.inf  # when a server may be of use, unless an event comes before

    @property
    def awaits_news(self) -> bool:
        """Whether a server may overtake the drone."""
        own = self.call.own
        return own is not None and own.is_open and not self.call.open_tries

    @property
    def due_s(self) -> list[float]:
        """When the drone or a second server joins the call, or a server may overtake the drone."""
        return [self._own_at_s if self.call.own is None else self._overtake_s, self._second_at_s]

    def begin(self, decision: Decision) -> None:
        """Attempt the call at the decided place, and plan what joins it there."""
        call, calls, self.is_decided = self.call, self.calls, True
        calls.take(call, decision)
        calls.hedging.called(call.operation)
        calls.deadlines.called(call.operation)
        if isinstance(decision, Remote) and not decision.raced:
            within_s = calls.deadlines.within_s(call.operation)
            self._hedge = calls.hedging.plan(
                decision, call.operation, is_busy=calls.is_busy, within_s=within_s
            )
            if self._hedge is not None:
                self._own_at_s = calls.now_s + self._hedge.after_s
                decision = replace(decision, deadline_s=self._hedge.deadline_s)
        if isinstance(decision, Remote):
            self._try(decision)
        if not isinstance(decision, Remote) or decision.raced:
            call.compute(call.operation)

    def look(self) -> None:
        """Have a second server or the drone join the call, or a server overtake the drone."""
        call, calls = self.call, self.calls
        if call.own is not None and call.own.is_open and not call.open_tries:
            if call.winner is None:  # else the drone tests its exception
                self._be_overtaken(call.own)
            return
        if calls.now_s >= self._second_at_s:
            self._ask_second()
        if (
            self._hedge
            and call.own is None
            and calls.now_s >= self._own_at_s
            and calls.lanes.is_free(ON_DRONE)
        ):
            calls.do(
                schema.Hedged(
                    waypoint=call.asked.waypoint,
                    server=call.tries[0].server,
                    check=call.tries[0].check,
                    after_s=self._hedge.after_s,
                    deadline_s=self._hedge.deadline_s,
                )
            )
            call.compute(call.operation)

    def tried(self, attempt: Attempt) -> None:
        """Wait for another try, or have the drone compute: once it has its turn, where a server did not begin."""
        call, calls = self.call, self.calls
        if not attempt.raised:
            if self._second_after_s < math.inf:
                self._ask_second()
            if call.open_tries:
                return
        if call.own is not None:
            if call.own.state == "failed":
                self._go_on_without(call.own)
        elif attempt.state == "queued" and calls.lanes.has_line and self._second_after_s == math.inf:
            self.queued_s = calls.now_s
            calls.leave(call)
            calls.enter(call, on_drone=True)
        else:
            self._fall_back()

    def turn(self) -> None:
        """Compute what a server did not begin."""
        self.calls.take(self.call, Local("the server has not begun it"))
        self.queued_s = self.calls.now_s - self.queued_s
        self._fall_back()

    def computed(self, own: Computing) -> None:
        """End the call with the drone's answer; with its failure only where no server may still answer."""
        if own.state == "failed":
            self._go_on_without(own)
            return
        if self.call.winner is not None:
            self.calls.outcomes.test(self.call.winner, raised=own.raised)
        self.calls.tell(events.LocalCallEnded(own.operation, own.took_s))
        self.call.end(own)

    def _go_on_without(self, own: Computing) -> None:
        """End the call with the drone's failure, unless another server may still answer it."""
        self.call.winner = None  # the drone cannot test an exception that a server has reported
        if not self.call.open_tries:
            self.call.end(own)

    # --- attempts -------------------------------------------------------------------------------------------

    def _try(self, remote: Remote) -> None:
        calls = self.calls
        self.call.tries, self.call.winner, self._is_seconded, self._second_s = [], None, False, None
        first, self._second_after_s = self._attempt(remote), math.inf
        if calls.deadlines.within_s(first.operation) is not None:
            second = calls.placement.second(first.operation, first.server, begins=False)
            plan = calls.deadlines.prospect(
                first.operation, first.server, None if second is None else second.name
            )
            if plan is not None and plan.after_s is not None:
                self._second_after_s = plan.after_s

    def _attempt(self, remote: Remote) -> Attempt:
        what = self.call.own or self.call  # which it overtakes
        return self.call.attempt(remote, what.operation, what.lightened)

    @property
    def _second_at_s(self) -> float:
        if not self.call.open_tries or self._is_seconded:
            return math.inf
        return self.call.tries[0].begun_s + self._second_after_s

    def _ask_second(self) -> None:
        """Send the call to another READY server too, in the time that is left, if one may get it."""
        if self._is_seconded:
            return
        first, calls = self.call.tries[0], self.calls
        self._is_seconded, after_s = True, calls.now_s - first.begun_s
        left_s = first.deadline_s - after_s
        if left_s <= 0 or not calls.deadlines.may_ask(first.operation):
            return
        server = calls.placement.second(first.operation, first.server, begins=True)
        if server is None:
            return
        calls.deadlines.asked(first.operation)
        self._second_s = after_s
        calls.do(
            schema.Seconded(
                waypoint=self.call.asked.waypoint,
                operation=str(first.operation),
                server=first.server,
                second=server.name,
                check=server.check,
                after_s=after_s,
                deadline_s=left_s,
            )
        )
        self._attempt(Remote(server.name, left_s, f"{first.server} is late"))

    def _be_overtaken(self, own: Computing) -> None:
        """Attempt the call at a server that would answer before the drone, which computes it."""
        calls, began_s = self.calls, own.began_s
        remote, self._overtake_s = calls.selection.overtake(
            own.operation,
            began_s=calls.now_s if began_s is None else began_s,
            now_s=calls.now_s,
            position=calls.here,
        )
        if remote is not None:
            calls.decided(self.call, own.operation, remote)
            self._is_overtaken = True
            self._try(remote)

    def _fall_back(self) -> None:
        """Compute on the drone: after a reported exception the same call, to test it; else perhaps a lighter one."""
        call, calls = self.call, self.calls
        self._own_at_s, self._hedge = math.inf, None
        lightened = None
        if call.winner is None and call.lightened is None:
            lightened = calls.selection.fall_back(call.operation, now_s=calls.now_s, position=calls.here)
        call.compute(lightened.operation if lightened else call.operation, lightened)

    # --- its record -----------------------------------------------------------------------------------------

    @property
    def fell_back(self) -> bool:
        """Whether the drone computed it because servers failed."""
        return bool(self.call.tries) and not self.call.open_tries

    def facts(self, source: Attempt | Computing) -> dict[str, Any]:
        """When the drone or a second server joined it, and what the drone has found of a server's exception."""
        facts = super().facts(source)
        if self._hedge is not None and self.call.own is not None:
            facts["hedged_s"] = self._hedge.after_s
        if isinstance(source, Attempt):
            return facts | {"second_s": self._second_s}
        return facts | {"remote_fault": self._verdict}

    def ended(self, source: Attempt | Computing) -> None:
        """Count the drone's work on a hedged call that its server has answered after all."""
        own, decision = self.call.own, self.call.decision
        if self._hedge is None or own is None or not isinstance(decision, Remote):
            return
        if isinstance(source, Attempt) and source.server == decision.server:
            onboard_s = 0.0 if own.began_s is None else self.calls.now_s - own.began_s
            self.calls.hedging.overtaken(self._hedge, decision, self.call.operation, onboard_s=onboard_s)

    @property
    def _verdict(self) -> Literal["", "confirmed", "denied"]:
        return self.call.winner.verdict if self.call.winner is not None else ""

    def said(self, attempt: Attempt | None) -> str:
        """What has become of the decision."""
        if attempt is not None:
            return f"; {attempt.server} became of use, and was sooner" if self._is_overtaken else ""
        if not isinstance(self.call.decision, Remote):
            return ""
        if self._verdict:
            return f"; it raised there, which was {self._verdict} on the drone"
        return f"; {'no usable answer, so' if self.fell_back else 'late, and sooner'} on the drone"
