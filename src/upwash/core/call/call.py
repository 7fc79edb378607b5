"""The life of one call: its place, its attempts, and the one rule that accepts an answer.

The first answer ends the call, unless the manner knows that a better answer may still come (twice.py).
Attempts that go on then are losers, whose answers are dropped. The manner says what is attempted when.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing, End
from upwash.core.call.manner import Manner, Once
from upwash.core.call.on_servers import OnServers
from upwash.core.call.single import Single
from upwash.core.call.steps import Asked
from upwash.core.call.twice import Twice
from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import Decision, Lightened, Remote, Wait
from upwash.eventlog import schema

if TYPE_CHECKING:
    from upwash.core.call.calls import Calls


@dataclass(slots=True, eq=False)
class Call:
    """One call of the mission, made at `made_s`; `Calls` tells it what happens, and passes on what it says."""

    asked: Asked
    is_waited_for: bool = False  # at rest
    is_enough: bool = False  # the mission needs no better answer, or none
    is_over: bool = False
    calls: Calls = field(init=False)
    made_s: float = 0.0
    manner: Manner | None = None  # once that is known
    # Its decision, when its turn in line has come.
    decision: Decision | None = None
    why: str = ""
    operation: Operation = field(init=False)  # that runs: lighter than asked, perhaps
    lightened: Lightened | None = None
    decided_s: float = 0.0
    check: int = 0  # that it waits for,
    check_until_s: float = math.inf  # at most
    waited_s: float = 0.0  # for that check
    wait: Literal["", "paid off", "failed"] = ""
    # Its attempts.
    tries: list[Attempt] = field(default_factory=list)  # the latest, at one server or at two
    winner: Attempt | None = None  # of these
    own: Computing | None = None

    def __post_init__(self) -> None:
        self.operation = self.asked.operation

    def make(self, calls: Calls) -> None:
        """Begin its life."""
        self.calls, self.made_s = calls, calls.now_s
        if self.asked.once:
            self.manner = Once(self)
        elif self.asked.on_servers:
            self.manner = OnServers(self)

    @property
    def open_tries(self) -> list[Attempt]:
        """The attempts at servers whose answers may still come."""
        return [attempt for attempt in self.tries if attempt.is_open]

    @property
    def due_s(self) -> list[float]:
        """When the call must be looked at; some of these times are over."""
        return [self.check_until_s, *(self.manner.due_s if self.manner is not None else ())]

    @property
    def awaits_news(self) -> bool:
        """Whether the call must be looked at after news, as its time has come or the news may help it."""
        if self.check or min(self.due_s) <= self.calls.now_s:
            return True
        return self.manner is not None and self.manner.awaits_news

    def look(self) -> None:
        """Do what is due now, or has become possible."""
        if not self.check:
            if self.manner is not None:
                self.manner.look()
        elif self.calls.now_s >= self.check_until_s or not self.calls.selection.is_awaited(self.check):
            self._decide_after_wait()

    # --- its place ------------------------------------------------------------------------------------------

    def decide(self, *, on_drone: bool = False, drone_is_busy: bool = False) -> None:
        """Decide where the call runs, now that its turn has come, and begin the first attempts."""
        if self.manner is not None and self.manner.is_decided:
            self.manner.turn()
            return
        calls, self.decided_s = self.calls, self.calls.now_s
        decision, effects = calls.selection.decide(
            self.operation,
            now_s=calls.now_s,
            position=calls.here,
            on_drone=on_drone,
            drone_is_busy=drone_is_busy,
        )
        self.why, self.lightened = decision.why, decision.inputs.lightened
        if self.lightened is not None:
            self.operation = self.lightened.operation
        calls.decided(self, self.operation, decision, effects)
        if self.manner is None:
            two = calls.selection.two_answers.get(self.operation)
            self.manner = Single(self) if two is None else Twice(self, two)
        if isinstance(decision, Wait) and self.manner.may_wait:
            self.check = calls.selection.servers[decision.server].check
            self.check_until_s = calls.now_s + decision.at_most_s
        else:
            self.decision = decision
            self.manner.begin(decision)

    def _decide_after_wait(self) -> None:
        calls = self.calls
        self.decision, effects = calls.selection.decide_after_wait(
            self.operation, self.check, now_s=calls.now_s, position=calls.here
        )
        calls.decided(self, self.operation, self.decision, effects)
        self.check, self.check_until_s = 0, math.inf
        self.wait = "paid off" if isinstance(self.decision, Remote) else "failed"
        self.why = f"{self.why}: {self.decision.why}"
        self.waited_s = calls.now_s - self.decided_s
        assert self.manner is not None  # noqa: S101 - it has let the call wait
        self.manner.begin(self.decision)

    # --- its attempts ---------------------------------------------------------------------------------------

    def attempt(self, remote: Remote, operation: Operation, lightened: Lightened | None) -> Attempt:
        """Attempt the call at a server, beside the latest tries."""
        calls = self.calls
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
        calls.lanes.hold(attempt, attempt.server, calls.now_s + calls.takes_s(attempt.server, operation))
        if attempt.sends_less:
            calls.do(steps.Reduce(attempt))
        else:
            calls.send(attempt, attempt.deadline_s)
        return attempt

    def compute(self, operation: Operation, lightened: Lightened | None = None) -> None:
        """Compute the call on the drone."""
        self.own = Computing(self, operation, lightened or self.lightened, self.calls.now_s)
        self.calls.begin_own(self.own)

    def is_late(self, attempt: Attempt) -> bool:
        """Whether the mission had another answer before."""
        has_heard = self.manner is not None and self.manner.has_heard
        return self.is_over or has_heard or self.winner not in (None, attempt)

    def tried(self, attempt: Attempt, state: End) -> None:
        """Accept the answer of an attempt at a server, or go on without one."""
        attempt.state = state
        self.calls.release(attempt)
        if self.is_over or self.winner is not None:
            return
        if state in ("answered", "raised"):
            self.winner = attempt
        if state == "answered":
            self.end(attempt)
        elif self.manner is not None:
            self.manner.tried(attempt)

    def computed(self, event: steps.Computed) -> None:
        """Accept the drone's own answer, or go on without one."""
        own = event.computing
        own.state, own.raised = "failed" if event.failed else "answered", event.raised
        own.took_s = self.calls.now_s - (own.began_s or 0.0)
        self.calls.end_own(own)
        if self.is_over:
            self.calls.do(schema.Dropped(operation=str(own.operation), place=ON_DRONE))
        elif self.manner is not None:
            self.manner.computed(own)

    # --- its end --------------------------------------------------------------------------------------------

    def abandon(self) -> None:
        """Drop all that is under way for it."""
        self.is_over = True
        for attempt in self.open_tries:
            attempt.state = "failed"
            self.calls.release(attempt)
            self.calls.do(steps.Stop(attempt))
        if (own := self.own) is not None and own.is_open:
            own.state = "failed"
            if own.began_s is not None:
                self.calls.do(steps.Stop(own))
            self.calls.end_own(own)
        self.calls.over(self)

    def end(self, source: Attempt | Computing) -> None:
        """End the call with the answer of that attempt or computation, or with the failure of the drone's service."""
        assert self.manner is not None  # noqa: S101 - it has made the attempt
        calls, own, self.is_over = self.calls, self.own, True
        if source.state == "answered":
            calls.do(self._record(source, self.manner))
        calls.do(steps.Answer(self, source))
        self.manner.ended(source)
        if own is not None and own is not source:
            if own.is_open and own.began_s is None:
                calls.end_own(own)  # it was still in line
            elif own.state == "failed":
                calls.do(schema.Dropped(operation=str(own.operation), place=ON_DRONE))
        calls.over(self)

    def _record(self, source: Attempt | Computing, manner: Manner) -> schema.Call:
        own, now_s = self.own, self.calls.now_s
        attempt = source if isinstance(source, Attempt) else None
        onboard_s = queued_s = 0.0
        if own is not None and (own is source or own.is_open or manner.may_wait):
            began_s = now_s if own.began_s is None else own.began_s
            onboard_s, queued_s = now_s - began_s, began_s - own.asked_s + manner.queued_s
        if own is not None and own.state == "answered":
            onboard_s = own.took_s
        return schema.Call(
            waypoint=self.asked.waypoint,
            operation=str(source.operation),
            place=name_of(attempt.server if attempt else None),
            check=attempt.check if attempt else None,
            decision=self.why + manner.said(attempt) + (attempt.told_of_sending if attempt else ""),
            at_s=self.made_s,
            delay_s=now_s - self.made_s,
            waited_s=self.waited_s,
            onboard_s=onboard_s,
            wait=self.wait,
            fell_back=attempt is None and manner.fell_back,
            queued_s=self.decided_s - self.made_s + queued_s or None,
            **(attempt.facts_of_sending if attempt else {}),
            **manner.facts(source),
        )
