"""What the manners of a call have in common: each says when the call is attempted where, and which answer ends it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from upwash.core.call.attempts import Attempt, Computing
from upwash.core.policies.policy import Decision

if TYPE_CHECKING:
    from upwash.core.call.call import Call


class Manner:
    """How one call is attempted, from its decision to its end."""

    may_wait = False  # for a check
    is_decided = False  # so that its turn in line has nothing decided
    has_heard = False  # the mission, a first answer
    queued_s = 0.0  # for the drone, in place of a server that did not begin it

    def __init__(self, call: Call) -> None:
        self.call = call
        self.calls = call.calls

    @property
    def fell_back(self) -> bool:
        """Whether the drone computes the call because servers failed."""
        return False

    @property
    def awaits_news(self) -> bool:
        """Whether news may help the call: a call that waits for an answer or for a time needs no news."""
        return False

    @property
    def due_s(self) -> list[float]:
        """When the call must be looked at; some of these times are over."""
        return []

    def begin(self, decision: Decision) -> None:
        """Begin the attempts that the decision has begin at once."""

    def look(self) -> None:
        """Do what is due now, or has become possible."""

    def tried(self, attempt: Attempt) -> None:
        """Go on after an attempt at a server that gave no answer."""

    def computed(self, own: Computing) -> None:
        """Go on after the drone's own computation, which has answered or failed."""

    def turn(self) -> None:
        """Go on, as a turn has come that has nothing decided."""

    def facts(self, source: Attempt | Computing) -> dict[str, Any]:
        """Facts of the call's log record, if that source has answered it."""
        return source.lightened.facts if source.lightened else {}

    def ended(self, source: Attempt | Computing) -> None:
        """Note what has ended the call."""

    def said(self, attempt: Attempt | None) -> str:
        """What has become of the decision, after a semicolon, if that attempt has answered, or the drone."""
        return ""


class Once(Manner):
    """A call that runs on the drone alone, and one time only; nothing is learnt from it."""

    is_decided = True

    def turn(self) -> None:
        """Compute the call on the drone."""
        self.call.decided_s, self.call.why = self.calls.now_s, "it runs once, and on the drone"
        self.calls.take(self.call, None)
        self.call.compute(self.call.operation)

    def computed(self, own: Computing) -> None:
        """End the call."""
        self.call.end(own)
