"""One object, one act: what the mission does at the place of an object that its answers show, once.

    an answer    goes to `tell` at once, and the drone flies on. Each wanted object of the answer is claimed.
    a claim      becomes an act at the object's place, at once or where that costs least (late_acts.py).
    the act      is done where the object lies by all photos until then. There is none for an object that turned out
                 to be another claimed object, that is no longer wanted, or that lies behind a fence.
    its answers  belong to the object: calls that the act makes and leaves open. The act is over with the last of them

In the mission's thread.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from upwash.core.planning.stay_or_go import StayRule
from upwash.drone.objects import Claim, FlightObjects, FoundObject
from upwash.drone.pending import AnswerAction, Calls, Demand, NoDemand, Pending, VehicleVerbs, position_of
from upwash.errors import AutopilotRefused
from upwash.eventlog import schema

T = TypeVar("T")
Act = Callable[[FoundObject], object]


class ObjectAnswer(AnswerAction[T]):
    """An answer for the user, and one act for each of its objects."""

    def __init__(
        self,
        vehicle: VehicleVerbs,
        calls: Calls,
        rule: StayRule,
        pending: Pending[T],
        act: Act,
        *,
        wanted: Act,
        tell: Callable[[T], object],
        failed: Callable[[Exception], object] | None,
    ) -> None:
        super().__init__(vehicle, calls, rule, NoDemand(pending), tell, failed=failed)
        self.on_object = act
        self.wanted = wanted
        self._claims: list[ObjectAct] = []

    @property
    def about(self) -> tuple[VehicleVerbs, Calls, StayRule]:
        """What acts on its objects work with."""
        return self._vehicle, self._calls, self._rule

    def finish(self, waited_s: float) -> None:
        """Claim the answer's objects, tell the answer, and owe the acts."""
        if (answer := self.answer_if_any()) is not None:
            taken_at = position_of(self.place) if self.place is not None else self._vehicle.position()
            findings = self._calls.objects.take(answer, self.pending.photo, taken_at)
            self._claims = [
                ObjectAct(self, claim) for claim in self._calls.objects.claim(findings, self.wanted)
            ]
        try:
            super().finish(waited_s)
        finally:
            for act in self._claims:
                self._vehicle.owe(act)

    def learn(self) -> None:
        """Have the rule learn from the answer, once; an object that it shows first is a demand."""
        if not self._is_learnt and not self.needs_server:
            self._is_learnt = True
            place = position_of(self.place) if self.place is not None else None
            self._rule.answered(self.pending.took_s, demanded=bool(self._claims), place=place)


class _Claimed(Demand[Any]):
    """Stands for the question about an object: whether the mission still acts on it."""

    def __init__(self, pending: Pending[Any], objects: FlightObjects, claim: Claim, wanted: Act) -> None:
        super().__init__(pending, bool)
        self._objects, self._claim, self._wanted = objects, claim, wanted

    @property
    def is_heard(self) -> bool:
        """True, as the answer is there."""
        return True

    @property
    def is_due(self) -> bool:
        """True."""
        return True

    def why_not(self) -> str:
        """Why the mission does not act on the object any more; "" if it does."""
        if not self._objects.is_alone(self._claim):
            return "it is the same object as another"
        return "" if self._wanted(self._objects.found(self._claim.key)) else "later photos have settled it"

    def holds(self) -> bool:
        """Whether the object is one of its own, and wanted."""
        return not self.why_not()


class ObjectAct(AnswerAction[Any]):
    """The act at the place of a claimed object."""

    demand: _Claimed

    def __init__(self, found_by: ObjectAnswer[Any], claim: Claim) -> None:
        vehicle, calls, rule = found_by.about
        objects = calls.objects
        demand = _Claimed(found_by.pending, objects, claim, found_by.wanted)
        super().__init__(vehicle, calls, rule, demand, found_by.on_object, failed=None)
        self._objects = objects
        self._claim = claim
        self.waypoint = found_by.waypoint
        self.object = claim.number
        self.is_away = True
        self._open = 0  # answers of its calls
        self._is_done = False
        self._locate()
        calls.note(schema.Demanded(waypoint=self.waypoint, object=objects.record(claim)))

    @property
    def is_held(self) -> bool:
        """Whether it waits for the end of another act, which may have the drone low over its object."""
        return self._calls.acting is not None

    def demands(self) -> bool:
        """Whether the object is wanted; its place is that of now."""
        holds = self.demand.holds()
        if holds:
            self._locate()
        return holds

    def come_back(self, waited_s: float) -> None:
        """Fly to the object, and act there; leave the act out if a fence forbids the way."""
        if self.demands():
            self._calls.note(
                schema.TurnedBack(
                    waypoint=self.waypoint, position=self._vehicle.position(), object=self.object
                )
            )
            assert self.place is not None  # noqa: S101 - of an object
            try:
                self._vehicle.fly(self.place, back=True)
            except AutopilotRefused as error:
                self._leave_out(str(error))
                return
        self.finish(waited_s)

    def finish(self, waited_s: float) -> None:
        """Act on the object if the mission still wants that."""
        del waited_s
        self.is_over = True
        if why := self.demand.why_not():
            self._leave_out(why)
            return
        with self._under_way():
            self._act(self._objects.found(self._claim.key))
        self._is_done = True
        self._note_if_over()

    def finish_on_ground(self) -> None:
        """Leave the act out, as the drone has landed."""
        self._leave_out("the drone has landed")

    def learn(self) -> None:
        """Nothing: its answer has taught the rule."""

    def begin_call(self) -> None:
        """Note that the act has left a call open."""
        self._open += 1

    def end_call(self, answer: AnswerAction[Any]) -> None:
        """Join the findings of a call that the act had left open, and note the act if that was the last one."""
        if (found := answer.answer_if_any()) is not None:
            self._objects.take(found, answer.pending.photo, self._objects.found(self._claim.key).position)
        self._open -= 1
        self._note_if_over()

    @contextlib.contextmanager
    def _under_way(self) -> Iterator[None]:
        """A block during which photos and calls are of this object."""
        before = self._calls.acting, self._objects.under_way
        self._calls.acting, self._objects.under_way = self, self.object
        try:
            yield
        finally:
            self._calls.acting, self._objects.under_way = before

    def _locate(self) -> None:
        found = self._objects.found(self._claim.key)
        self.place = found.position

    def _note_if_over(self) -> None:
        if self._is_done and not self._open:
            self._calls.note(schema.Acted(waypoint=self.waypoint, object=self._objects.record(self._claim)))

    def _leave_out(self, why: str) -> None:
        self.is_over = True
        self._objects.release_if_joined(self._claim)
        self._calls.note(schema.NotActed(waypoint=self.waypoint, object=self._claim.number, why=why))


class ObjectActs:
    """Makes of each answer what has its objects acted on."""

    def __init__(self, vehicle: VehicleVerbs, calls: Calls, rule: StayRule) -> None:
        self._vehicle = vehicle
        self._calls = calls
        self._rule = rule

    def answer(
        self,
        pending: Pending[T],
        act: Act,
        *,
        wanted: Act | None,
        tell: Callable[[T], object] | None,
        failed: Callable[[Exception], object] | None,
    ) -> ObjectAnswer[T]:
        """What the mission does about the answer: by default it wants every object, and tells nothing."""
        return ObjectAnswer(
            self._vehicle,
            self._calls,
            self._rule,
            pending,
            act,
            wanted=wanted or (lambda _: True),
            tell=tell or (lambda _: None),
            failed=failed,
        )
