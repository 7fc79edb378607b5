"""A plan that stops at each waypoint, with one open answer at most; in the mission's thread.

The drone flies one leg with the answer open. After a demand on the way it brakes, flies back, acts, and sets off
again. At the next waypoint it does all that comes before the next call, then waits, and flies one leg back if the
answer has a demand. An act that costs less further on is put off (late_acts.py).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from upwash.drone.answers import AnswerAction
from upwash.drone.late_acts import Onwards
from upwash.drone.pending import Demand
from upwash.drone.places import Place, position_of
from upwash.drone.settling import Settling


@dataclass(kw_only=True, eq=False)
class Stops(Settling):
    """Settles an answer before the leg after the next one."""

    _open: AnswerAction[Any] | None = field(default=None, init=False)
    _due: list[AnswerAction[Any]] = field(default_factory=list, init=False)  # acts that are done now
    _owed: list[AnswerAction[Any]] = field(default_factory=list, init=False)  # acts whose time is not decided
    _acts: bool = field(default=False, init=False)

    def goto(self, place: Place, *, unless: Demand[Any] | None = None) -> bool:
        """Fly to a place, from rest to rest; without `unless` with the answer open."""
        self._act_before(place)
        if unless is not None:
            return self.fly_unless(place, unless)
        if self._open is None:
            self.fly(place)
        else:
            with self._settling(self._open) as answer:
                self.fly_on(answer, place)
        return True

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Have the next leg, call or verb settle the answer."""
        self._open = answer

    def owe(self, act: AnswerAction[Any]) -> None:
        """Do the act before the next leg, or put it off."""
        self._owed.append(act)

    def settle(self, *, comes_back: bool = True) -> None:
        """Wait for the open answer, and do all acts; come back to the last place, or do not."""
        self.thread.require_turn()
        here = self.legs.place
        self._settle_open()
        while acts := self.late.acts.all() + self._taken_owed():
            self._act(acts)
            self._settle_open()
        if comes_back and here is not None and here != self.legs.place:
            self.fly(here, back=True)

    def settle_for_call(self) -> None:
        """Settle the open answer; its act may be put off."""
        self._settle_open(puts_off=True)

    def fly_on(self, answer: AnswerAction[Any], place: Place) -> None:
        """Fly one leg with the answer open; wait for it before another leg."""
        if answer.is_away and not answer.only_tells:
            self._settle_answer(answer, puts_off=True)
            self.fly(place)
            return
        answer.is_away = True
        if not self.fly_unless(place, answer, late=answer):
            if not answer.is_over:  # else its acts are done
                self.come_back(answer)
            self.fly(place)
        elif answer.call.is_over and not answer.is_over:  # in the moment of the arrival, or demanding nothing
            self._settle_answer(answer, puts_off=True)

    def _settle_open(self, *, puts_off: bool = False) -> None:
        if self._open is not None:
            with self._settling(self._open) as answer:
                self._settle_answer(answer, puts_off=puts_off)

    def _settle_answer(self, answer: AnswerAction[Any], *, puts_off: bool) -> None:
        """Wait for the last answer; if it has a demand, fly to its waypoint, act, and come back here."""
        here, waited_s = self.legs.place, answer.call.wait()
        if not (answer.is_away and answer.demands()):
            answer.finish(waited_s)
            return
        if puts_off and here and self._is_put_off(answer, Onwards.straight_to(here, rests=True)):
            return
        self.come_back(answer, waited_s)
        if here is not None:
            self.fly(here)

    @contextlib.contextmanager
    def _settling(self, answer: AnswerAction[Any]) -> Iterator[AnswerAction[Any]]:
        """Close the open answer during the block, as acting on it flies too; reopen it if the block fails."""
        self.thread.require_turn()
        self._open = None
        try:
            yield answer
        finally:
            if not answer.is_over:
                self._open = answer

    def _act_before(self, place: Place) -> None:
        if not (self.late.acts or self._due or self._owed) or self._acts:
            return
        here, onwards = self.legs.place, Onwards(place, position_of(place))
        due = self.late.due_after(here)
        self._act([*due, *self.thread.call(self.late.due(onwards)), *self._owed_now(onwards)])
        now = self.legs.place
        if here and now and here != now and not self.legs.allows(position_of(now), position_of(place)):
            self.fly(here, back=True)

    def _arrives(self, place: Place, late: AnswerAction[Any] | None) -> bool:
        """As in general; False after acts on objects that the answer shows."""
        if late is not None and late.only_tells:
            late.finish(0.0)
        due = [] if self._acts else self._owed_now(Onwards.straight_to(place, rests=False))
        self.thread.call(self.legs.stop_short_of(position_of(place)) if due else self.legs.arrive())
        self._act(due)
        return not due

    def _owed_now(self, onwards: Onwards) -> list[AnswerAction[Any]]:
        return [act for act in self._taken_owed() if not (act.demands() and self._is_put_off(act, onwards))]

    def _taken_owed(self) -> list[AnswerAction[Any]]:
        owed, self._owed = self._owed, []
        return owed

    def _act(self, acts: Sequence[AnswerAction[Any]]) -> None:
        """Do these acts one after the other; those that an exception of one leaves are done with the next."""
        self._due += acts
        if self._acts:
            return
        self._acts = True
        try:
            while self._due:
                self.come_back(self._due.pop(0))
        finally:
            self._acts = False
