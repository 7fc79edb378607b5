"""Calls that only servers compute: each waits in line for a server, and ends once.

    answered      A server that is ready in range has answered. After a failure the call is in line again, at its old
                  place.
    unanswered    The deadline, the bound of memory or the end of the flight has come, or the service raised twice.

A reported exception blames the server at first. A second report, of any server, blames the call, which ends.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt
from upwash.core.call.manner import Manner
from upwash.core.policies.policy import NO_INPUTS, Decision, Remote
from upwash.core.selection.events import CallWaits
from upwash.eventlog import schema

if TYPE_CHECKING:
    from upwash.core.call.call import Call

_QUEUED_S = 1.0  # until a call goes where it was not begun
_LEAST_S, _FACTOR = 10.0, 3.0


def patience_s(reach_s: float) -> float:
    """The seconds that a server in range has where the mission waits: three times what is expected, 10 s at least."""
    return max(_LEAST_S, _FACTOR * reach_s)


class OnServers(Manner):
    """A call that only servers compute."""

    def __init__(self, call: Call) -> None:
        super().__init__(call)
        within_s = call.asked.within_s
        self._limit_s = math.inf if within_s is None else self.calls.now_s + within_s
        self._why = f"no server answered within {within_s:g} s" if within_s is not None else ""
        self._again_s = math.inf  # when it goes into the line again,
        self._again_after: int | None = None  # or when more has happened than that
        self._has_raised = False
        self.calls.tell(CallWaits(call.asked.operation))

    @property
    def awaits_news(self) -> bool:
        """Whether the next event puts the call into the line again."""
        return self._again_after is not None

    @property
    def due_s(self) -> list[float]:
        """When it ends, or goes into the line again."""
        return [self._limit_s, self._again_s]

    def begin(self, decision: Decision) -> None:
        """Attempt it at the decided server; without one wait for news, which may change what the policy thinks."""
        if isinstance(decision, Remote):
            self.calls.take(self.call, decision)
            self._try(decision)
        else:
            self.calls.leave(self.call)
            self._again_after = self.calls.happened

    def look(self) -> None:
        """End the call, or put it into the line again."""
        has_news = self._again_after is not None and self.calls.happened > self._again_after
        if self.calls.now_s >= self._limit_s:
            self._end()
        elif self.calls.now_s >= self._again_s or has_news:
            self._enter_again()

    def tried(self, attempt: Attempt) -> None:
        """Put the call into the line again, unless the exception was the call's own."""
        if attempt.state == "queued":
            self._again_s = self.calls.now_s + _QUEUED_S
        elif not attempt.raised or self._blames_no_call(attempt):
            self._enter_again()

    def _blames_no_call(self, attempt: Attempt) -> bool:
        """Blame the part, the server or the call for an exception; return whether the call waits for a server again.

        The call is over if the exception was its own. After a smaller request the whole request may be sent at once.
        """
        why = f"{attempt.server} says that {attempt.operation} raised {attempt.raised}"
        if attempt.sends_less:  # which may be the fault of what was sent
            self.calls.outcomes.part_failed(attempt.operation, why)
            if not self.calls.placement.may_send(attempt.server, attempt.check):
                return True
            longer = (attempt.inputs.whole_s or 1.0) / (attempt.inputs.less_s or 1.0)
            self._try(Remote(attempt.server, longer * attempt.deadline_s, "", inputs=NO_INPUTS))
            return False
        self.calls.outcomes.blame(attempt, why, confirmed=self._has_raised)
        if self._has_raised:
            self._why = f"{why}, as at the attempt before"
            self._end()
            return False
        self._has_raised = True
        return True

    def hurry(self) -> None:
        """The mission waits for the call: without a deadline it waits only while a server in range can answer."""
        if self._limit_s < math.inf:
            return
        reach_s = self.calls.selection.planning.reach_s(self.call.asked.operation)
        if reach_s is None:
            self.limit("no server in range can answer, and the mission waits")
        else:
            limit_s = patience_s(reach_s * len(self.calls.waiting))
            self.limit(f"no server in range answered within {limit_s:.0f} s", in_s=limit_s)

    def limit(self, why: str, *, in_s: float = 0.0) -> None:
        """End the call without an answer after that time, unless it ends before."""
        if (until_s := self.calls.now_s + in_s) < self._limit_s:
            self._limit_s, self._why = until_s, why
            self.calls.wake()

    def _try(self, remote: Remote) -> None:
        self.call.tries, self.call.winner = [], None
        self.call.attempt(remote, self.call.operation, None)

    def _enter_again(self) -> None:
        self._again_s, self._again_after = math.inf, None
        self.calls.leave(self.call)
        self.calls.tell(CallWaits(self.call.asked.operation, again=True))
        self.calls.enter(self.call)

    def _end(self) -> None:
        call, calls = self.call, self.calls
        call.abandon()
        calls.do(
            schema.Unanswered(
                waypoint=call.asked.waypoint,
                operation=str(call.asked.operation),
                at_s=call.made_s,
                waited_s=calls.now_s - call.made_s,
                within_s=call.asked.within_s,
                why=self._why,
            )
        )
        calls.do(steps.LeftUnanswered(call, self._why))
