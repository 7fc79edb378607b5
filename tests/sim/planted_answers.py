"""Defects planted in calls with two answers: `planted.py` lists them."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace
from tests.sim.planting import planted

from upwash.core.call.call import Call
from upwash.core.call.twice import Twice
from upwash.core.selection.settings import TwoAnswers
from upwash.drone.answers import AnswerAction
from upwash.drone.offloading import Offloading
from upwash.drone.pending import Demand
from upwash.drone.settling import Settling


@planted("a better answer counts after its deadline", Twice, "__init__")
def waits_longer(init: Any, self: Twice, call: Call, two: TwoAnswers) -> None:
    init(self, call, replace(two, within_s=two.within_s + 20.0))


@planted("the first answer counts where a better one came", Offloading, "_answer")
def keeps_the_first(answer: Any, self: Offloading, call: Call, reply: Any) -> None:
    heard = self._open[call].hearing.first
    answer(self, call, heard.result() if heard.done() else reply)


@planted("the demand of a better answer is not met", Demand, "holds")
def judges_once(holds: Any, self: Demand[Any]) -> bool:
    return holds(self) if self._holds is None else self._holds


@planted("the demand of each of two answers is met", AnswerAction, "finish")
def acts_on_both(finish: Any, self: AnswerAction[Any], waited_s: float) -> None:
    was_open = not self.call.is_over
    finish(self, waited_s)
    if was_open:
        self._act(self.call.answer_of(self.call.reply))


@planted("a waypoint is done with its first answer", Settling, "hear")
def takes_the_first(hear: Any, self: Settling, answer: AnswerAction[Any]) -> bool:
    is_over: bool = hear(self, answer)
    if not is_over:
        answer.call.take(0.0)
    return is_over
