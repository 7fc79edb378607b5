"""Calls with two answers: the drone computes the first, which the mission hears at once; a better one may come.

The drone computes at once, or later where a server is READY and not late. An answer by the deadline of any server is
better. The call is over with the better answer, or once no better answer can come.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing
from upwash.core.call.manner import Manner
from upwash.core.policies.policy import Decision, Remote
from upwash.core.selection.events import LocalCallEnded
from upwash.core.selection.settings import TwoAnswers

if TYPE_CHECKING:
    from upwash.core.call.call import Call

_MOMENT_S = 0.001  # before a deadline: a timer may run early


class Twice(Manner):
    """A call with two answers."""

    def __init__(self, call: Call, two: TwoAnswers) -> None:
        super().__init__(call)
        self._first = two.first
        self._by_s = call.made_s + two.within_s
        self._own_at_s = math.inf  # where a server is expected before the drone
        self._better: Remote | None = None  # the decision for the better answer, before its attempt
        self._has_place = False  # its place in line is that server's, whose attempt has not begun
        self._holds_place: Attempt | None = None  # the attempt that has begun there
        self._none_comes = False  # no better answer
        self._has_failed = False  # a server
        self._first_s: float | None = None  # from the call to the first answer

    @property
    def fell_back(self) -> bool:
        """Whether a server failed to give the better answer."""
        return self._has_failed

    @property
    def awaits_news(self) -> bool:
        """Whether a server for the better answer may come."""
        return not self._none_comes

    @property
    def due_s(self) -> list[float]:
        """When the drone computes, and when no better answer counts any more."""
        return [
            self._own_at_s if self.call.own is None else math.inf,
            math.inf if self._none_comes else self._by_s,
        ]

    def begin(self, decision: Decision) -> None:
        """Have a server compute the better answer if one can, and the drone the first."""
        call, calls = self.call, self.calls
        calls.take(call, decision)
        calls.hedging.called(call.operation)
        if isinstance(decision, Remote):
            self._better = decision
            if not decision.raced:
                self._has_place = True
                hedge = calls.hedging.plan(decision, self._first, is_busy=False)
                self._own_at_s = calls.now_s + (hedge.after_s if hedge else decision.deadline_s)
        self._seek()
        if self._own_at_s == math.inf or self._none_comes:
            call.compute(self._first)

    def look(self) -> None:
        """Seek a server for the better answer; end the call where none can come."""
        self._seek()
        if self.call.own is None and (self.calls.now_s >= self._own_at_s or self._none_comes):
            self.call.compute(self._first)
        self._end()

    def tried(self, attempt: Attempt) -> None:
        """Seek another server, and have the drone compute the first answer; after an exception none is sought."""
        if attempt is self._holds_place:
            self.calls.leave(self.call)
        self._has_failed, self._none_comes = True, bool(attempt.raised)
        self._seek()
        if self.call.own is None:
            self.call.compute(self._first)
        self._end()

    def computed(self, own: Computing) -> None:
        """Tell the first answer; it ends the call where no better one can come."""
        if not self._has_place:
            self.calls.leave(self.call)
        if own.state == "answered":
            self.calls.tell(LocalCallEnded(own.operation, own.took_s, asked=self.call.operation))
            self._first_s = self.calls.now_s - self.call.made_s
            self.has_heard = not own.raised
            if self.has_heard:
                self.calls.do(steps.Hear(own, self._first_s))
        self._end()

    def _end(self) -> None:
        own = self.call.own
        if own is not None and not own.is_open and (self._none_comes or self.call.is_enough):
            self.call.end(own)

    def _seek(self) -> None:
        """Attempt the call at a server that can give the better answer in time, or give that up."""
        call, calls = self.call, self.calls
        if self._none_comes or call.open_tries:
            return
        remote, self._better = self._better, None
        left_s = self._by_s - calls.now_s
        is_decided = remote is not None and left_s > _MOMENT_S
        if remote is None or not is_decided or not (self._has_place or self._is_next(remote.server)):
            remote = self._sought(left_s)
        if remote is not None or self._none_comes:
            calls.wanted.pop(call, None)
        if remote is None:
            return
        call.tries, call.winner = [], None
        has_place, self._has_place = self._has_place, False
        attempt = call.attempt(
            replace(remote, deadline_s=min(remote.deadline_s, left_s)), call.operation, call.lightened
        )
        self._holds_place = attempt if has_place else None

    def _sought(self, left_s: float) -> Remote | None:
        if left_s <= _MOMENT_S or self.call.is_enough:
            self._none_comes = True
            return None
        call, calls, server = self.call, self.calls, self.calls.selection.current
        is_next = server is not None and self._is_next(server.name)
        remote, may_come = calls.placement.better(call.operation, self._by_s, is_next=is_next)
        if remote is not None:
            calls.decided(call, call.operation, remote)
        self._none_comes = remote is None and call.is_waited_for and not may_come
        return remote

    def _is_next(self, server: str) -> bool:
        return self.calls.is_next(self.call, server, self._by_s)

    def facts(self, source: Attempt | Computing) -> dict[str, Any]:
        """When the first answer came, and the call's own operation if the first answer counts."""
        facts: dict[str, Any] = {"first_s": self._first_s}
        if isinstance(source, Computing):
            return facts | {"asked": str(self.call.operation)}
        return facts | super().facts(source)

    def said(self, attempt: Attempt | None) -> str:
        """Which of the two answers counts."""
        if attempt is None:
            return "; the first answer counts, as no better one came"
        return "" if self._first_s is None else f"; the better answer, of {attempt.server}"
