"""What a mission does about an answer, from the call on until it is done."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVar

from upwash.core.geo import Position, distance_m
from upwash.core.planning.stay_or_go import StayRule
from upwash.drone.objects import ActOnObject
from upwash.drone.pending import Demand, OpenCall
from upwash.drone.places import Place, index_of, position_of
from upwash.eventlog import schema

T = TypeVar("T")


class AnswerAction(Demand[T]):
    """What to do about an answer: `act`, at its place, if the answer demands it.

    An exception of the call goes to `failed` there, or to the mission without `failed`. Without a question `act` only
    notifies, of each answer, at any place. The call is `of` the act on an object that made it.
    """

    def __init__(
        self,
        call: OpenCall,
        question: Callable[[T], object] | None,
        act: Callable[[T], object],
        *,
        place: Place | None,
        rule: StayRule,
        failed: Callable[[Exception], object] | None = None,
        of: ActOnObject | None = None,
    ) -> None:
        super().__init__(call, question)
        self.place = place
        self.waypoint = index_of(place)
        self.object: int | None = None  # the number of the object that is acted on
        self.is_away = False  # whether the drone has left the waypoint
        self.is_over = False  # the act is done, or put off
        self._act = act
        self.rule = rule
        self._failed = failed
        self._of = of
        self._is_noted = self._is_learnt = False
        if of is not None:
            of.begin_call()

    @property
    def is_held(self) -> bool:
        """Whether nothing is done about it for now."""
        return False

    def away_m(self, here: Position) -> float:
        """How far its place is from here."""
        return 0.0 if self.place is None else distance_m(here, position_of(self.place))

    def demands(self) -> bool:
        """Whether the answer, which is there, has a demand; logs one."""
        holds = self.holds()
        if holds and not self._is_noted:
            self._is_noted = True
            self.note()
        return holds

    def come_back(self, fly: Callable[[Place], object], here: Position, waited_s: float) -> None:
        """Fly from here to its place, and act there."""
        self.call.note(schema.TurnedBack(waypoint=self.waypoint, position=here))
        if self.place is not None:
            fly(self.place)
        self.finish(waited_s)

    def finish(self, waited_s: float) -> None:
        """Take the answer, and act if it has a demand."""
        self.is_over = True
        self.call.end()  # the first of two answers is acted on
        self.learn()
        demanded = self.holds()
        self.call.take(waited_s, demanded=demanded)
        if self._of is not None:
            self._of.end_call(self.answer_if_any(), self.call.photo)
        try:
            answer = self.call.answer_of(self.call.reply)
        except Exception as error:
            if self._failed is None:
                raise
            self._have_told(partial(self._failed, error))
        else:
            if demanded or self.only_tells:
                self._have_told(partial(self._act, answer))
        if demanded:
            self.call.note(schema.Acted(waypoint=self.waypoint))

    def finish_on_ground(self) -> None:
        """The same after the landing."""
        self.finish(0.0)

    def answer_if_any(self) -> T | None:
        """The answer that is there; None if the call has failed."""
        try:
            answer: T = self.call.answer_of(self.call.reply)
        except Exception:  # noqa: BLE001 - it is raised where the mission takes the answer
            return None
        return answer

    def put_off(self) -> None:
        """Note that the act is put off: the answer is none that is waited for."""
        self.is_over = True
        if self.call.is_alone:  # the mission makes its next call
            self.call.end()
        self.learn()

    def learn(self) -> None:
        """Have the rule learn from the last answer, once."""
        if (
            self.call.needs_server or self.only_tells
        ):  # it says little of the answers that the drone may wait for
            return
        if self.call.is_over:
            self._learn(demanded=self.holds())

    def _learn(self, *, demanded: bool) -> None:
        if not self._is_learnt:
            self._is_learnt = True
            place = position_of(self.place) if self.place is not None else None
            self.rule.answered(self.call.took_s, demanded=demanded, place=place)

    def _have_told(self, do: Callable[[], object]) -> None:
        with self.call.thread.only_messages() if self.only_tells else contextlib.nullcontext():
            self.call.look(do)


async def one_answered(
    answers: Iterable[Demand[Any]], *, waits: bool = False, within_s: float | None = None
) -> None:
    """Return when one of the calls has an answer that was not looked at; there must be a call. For the loop.

    With `waits` the drone rests meanwhile, so that no server comes nearer.
    """
    for answer in answers if waits else ():
        answer.call.hearing.waits.set()
    news = set().union(*(answer.news for answer in answers))
    await asyncio.wait(news, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)
