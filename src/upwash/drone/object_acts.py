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

from upwash.core.geo import Position
from upwash.drone.answered_photos import NumberedPhoto
from upwash.drone.answers import AnswerAction
from upwash.drone.objects import Claim, FlightObjects, FoundObject
from upwash.drone.pending import OpenCall
from upwash.drone.places import Place, position_of
from upwash.drone.settling import Settling
from upwash.errors import AutopilotRefused
from upwash.eventlog import schema

T = TypeVar("T")
Act = Callable[[FoundObject], object]


class ObjectAnswer(AnswerAction[T]):
    """An answer with one act for each wanted object, by default for all, and perhaps a message for the user."""

    def __init__(
        self,
        settling: Settling,
        call: OpenCall,
        act: Act,
        *,
        wanted: Act | None,
        tell: Callable[[T], object] | None,
        failed: Callable[[Exception], object] | None,
    ) -> None:
        super().__init__(
            call,
            None,
            tell or (lambda _: None),
            place=settling.legs.place,
            rule=settling.rule,
            failed=failed,
        )
        self._settling = settling
        self.on_object = act
        self.wanted = wanted or (lambda _: True)
        self._claims: list[ObjectAct] = []

    def finish(self, waited_s: float) -> None:
        """Claim the answer's objects, tell the answer, and owe the acts."""
        if (answer := self.answer_if_any()) is not None:
            objects, place = self._settling.objects, self.place
            taken_at = position_of(place) if place is not None else self._settling.legs.position
            findings = objects.take(answer, self.call.photo, taken_at)
            self._claims = [ObjectAct(self, objects, claim) for claim in objects.claim(findings, self.wanted)]
        try:
            super().finish(waited_s)
        finally:
            for act in self._claims:
                self._settling.owe(act)

    def learn(self) -> None:
        """Have the rule learn from the answer, once; an object that it shows first is a demand."""
        if not self.call.needs_server:
            self._learn(demanded=bool(self._claims))


class ObjectAct(AnswerAction[Any]):
    """The act at the place of a claimed object; its demand is that the mission still acts on the object."""

    place: Position
    is_heard = is_due = True  # as the answer is there

    def __init__(self, found_by: ObjectAnswer[Any], objects: FlightObjects, claim: Claim) -> None:
        super().__init__(found_by.call, bool, found_by.on_object, place=None, rule=found_by.rule)
        self._wanted = found_by.wanted
        self._objects = objects
        self._claim = claim
        self.waypoint = found_by.waypoint
        self.object = claim.number
        self.is_away = True
        self._open = 0  # answers of its calls
        self._is_done = False
        self._locate()
        self.call.note(schema.Demanded(waypoint=self.waypoint, object=self._objects.record(claim)))

    @property
    def _found(self) -> FoundObject:
        return self._objects.found(self._claim.key)

    def _why_not(self) -> str:
        """Why the mission does not act on the object any more; "" if it does."""
        if not self._objects.is_alone(self._claim):
            return "it is the same object as another"
        return "" if self._wanted(self._found) else "later photos have settled it"

    def holds(self) -> bool:
        """Whether the object is one of its own, and wanted."""
        return not self._why_not()

    @property
    def is_held(self) -> bool:
        """Whether it waits for the end of another act, which may have the drone low over its object."""
        return self._objects.acting is not None

    def demands(self) -> bool:
        """Whether the object is wanted; its place is that of now."""
        if holds := self.holds():
            self._locate()
        return holds

    def come_back(self, fly: Callable[[Place], object], here: Position, waited_s: float) -> None:
        """Fly to the object, and act there; leave the act out if a fence forbids the way."""
        if self.demands():
            self.call.note(schema.TurnedBack(waypoint=self.waypoint, position=here, object=self.object))
            try:
                fly(self.place)
            except AutopilotRefused as error:
                self._leave_out(str(error))
                return
        self.finish(waited_s)

    def finish(self, waited_s: float) -> None:
        """Act on the object if the mission still wants that."""
        del waited_s
        self.is_over = True
        if why := self._why_not():
            self._leave_out(why)
            return
        with self._under_way():
            self._act(self._found)
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

    def end_call(self, answer: Any, photo: NumberedPhoto | None) -> None:
        """Join the findings of a call that the act had left open, and note the act if that was the last one."""
        if answer is not None:
            self._objects.take(answer, photo, self._found.position)
        self._open -= 1
        self._note_if_over()

    @contextlib.contextmanager
    def _under_way(self) -> Iterator[None]:
        before, self._objects.acting = self._objects.acting, self
        try:
            yield
        finally:
            self._objects.acting = before

    def _locate(self) -> None:
        self.place = self._found.position

    def _note_if_over(self) -> None:
        if self._is_done and not self._open:
            self.call.note(schema.Acted(waypoint=self.waypoint, object=self._objects.record(self._claim)))

    def _leave_out(self, why: str) -> None:
        self.is_over = True
        self._objects.release_if_joined(self._claim)
        self.call.note(schema.NotActed(waypoint=self.waypoint, object=self._claim.number, why=why))
