"""Flies to where a mission sends the drone, and settles its answers meanwhile; in the mission's thread.

stay    wait, then act at the waypoint
go      fly on with the answer open: `Stops` (stops.py) over one leg, `Rows` (rows.py) with several open answers
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from msgspec.structs import asdict

from upwash.core.planning.stay_or_go import Outlook, StayRule, StayVerdict
from upwash.drone.answers import AnswerAction
from upwash.drone.late_acts import LateActs, Onwards
from upwash.drone.legs import Legs
from upwash.drone.mission import MissionThread
from upwash.drone.objects import FlightObjects
from upwash.drone.pending import Demand, OpenCall
from upwash.drone.places import Place, position_of
from upwash.eventlog import schema

T = TypeVar("T")


@dataclass(kw_only=True, eq=False)
class Settling:
    """What all manners of settling have; `outlook` returns what flying on before the open call is over would cost."""

    legs: Legs
    thread: MissionThread
    late: LateActs
    rule: StayRule
    objects: FlightObjects
    outlook: Callable[[], Outlook | None]

    def goto(self, place: Place, *, unless: Demand[Any] | None = None) -> bool:
        """Fly to a place as the mission says; False, at rest on the way, for a demand."""
        raise NotImplementedError

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Have the verbs that follow settle the answer."""
        raise NotImplementedError

    def owe(self, act: AnswerAction[Any]) -> None:
        """Have the verbs that follow do the act, whose answer is there, or put it off."""
        raise NotImplementedError

    def settle(self, *, comes_back: bool = True) -> None:
        """Wait for all open answers, and do what they demand; come back to the last place, or do not."""
        raise NotImplementedError

    def settle_for_call(self) -> None:
        """Settle what has to be before the mission makes another call."""

    def rest(self) -> None:
        """Brake, and come back to the last place."""

    def leave(self) -> None:
        """Fly over the places after the last waypoint."""

    def seek_answers(self) -> None:
        """Before the way home, fly to a place where servers answer waiting calls, if the detour pays."""

    def after_landing(self) -> None:
        """Wait for the answers that servers give at home, and take all; the others have none."""

    def action(
        self,
        call: OpenCall,
        question: Callable[[T], object] | None,
        act: Callable[[T], object],
        failed: Callable[[Exception], object] | None,
    ) -> AnswerAction[T]:
        """What the mission does about an answer to a call that it made here."""
        place, of = self.legs.place, self.objects.acting
        return AnswerAction(call, question, act, place=place, rule=self.rule, failed=failed, of=of)

    def take_up(self, answer: AnswerAction[Any]) -> None:
        """Wait for the answer and settle it, or leave it open and return."""
        if answer.call.needs_server or self._goes(answer) or not self.hear(answer):
            self.leave_open(answer)

    def _goes(self, answer: AnswerAction[Any]) -> bool:
        if self.rule.manner == "stay" or answer.call.is_over:
            return False
        verdict = self.thread.call(self._judge(answer.place))
        self._note(schema.StayOrGo(waypoint=answer.waypoint, **asdict(verdict)))
        return verdict.goes

    async def _judge(self, place: Place | None) -> StayVerdict:
        return self.rule.decide(self.outlook(), position_of(place) if place is not None else None)

    def hear(self, answer: AnswerAction[Any]) -> bool:
        """Wait for the answer, of two for the first; act on it, or return False where a better one may come."""
        waited_s = answer.call.wait(first=True)
        if not answer.holds() and not answer.call.is_over:
            return False
        answer.finish(waited_s)
        return True

    def come_back(self, answer: AnswerAction[Any], waited_s: float = 0.0) -> None:
        """Fly to the answer's place, and act there."""
        answer.come_back(partial(self.fly, back=True), self.legs.position, waited_s)

    def fly(self, place: Place, *, back: bool = False) -> None:
        """Fly to a place, `back` to a waypoint whose calls are over, from rest to rest."""
        self.thread.call(self.legs.goto(place, back=back))

    def fly_unless(self, place: Place, unless: Demand[Any], *, late: AnswerAction[Any] | None = None) -> bool:
        """The same; False, at rest on the way, for a demand. The act of a `late` answer may be put off."""
        legs = self.legs
        if self.thread.call(legs.until_answered(legs.goto(place), unless)):
            return True
        try:
            while not unless.holds():
                if unless.call.is_over:
                    return self._arrives(place, late)
                if self.thread.call(legs.until_answered(None, unless)):  # a better answer may come
                    return True
            if late is None:
                unless.note()  # before it brakes: who takes the vehicle then has it with this left undone
            elif late.demands() and self._is_put_off(late, Onwards.straight_to(place, rests=False)):
                self.thread.call(legs.arrive())
                return True
        except BaseException:
            self.thread.call(legs.stop_short_of(position_of(place)))
            raise
        self.thread.call(legs.stop_short_of(position_of(place)))
        return False

    def _arrives(self, place: Place, late: AnswerAction[Any] | None) -> bool:
        """Fly on to the place with an answer that demands nothing; return whether the drone arrives."""
        del place, late
        self.thread.call(self.legs.arrive())
        return True

    def _is_put_off(self, act: AnswerAction[Any], onwards: Onwards) -> bool:
        if not self.thread.call(self.late.puts_off(act, onwards)):
            return False
        act.put_off()
        return True

    def _note(self, event: schema.Event) -> None:
        self.thread.post(lambda: self.legs.journal.record(event))
