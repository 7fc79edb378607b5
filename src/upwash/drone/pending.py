"""A call that a mission has started: what the mission has of it, and the questions about its answer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, cast

from upwash.core.operation import Operation
from upwash.drone.answered_photos import AnsweredPhotos, NumberedPhoto
from upwash.drone.mission import MissionThread
from upwash.errors import Unanswered
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method
from upwash.support.background import begin, now_s
from upwash.support.text import message_of

T = TypeVar("T")


class Hearing:
    """The mission's part in a call with two answers, on the loop; `first` is the first answer, as decoded.

    The mission sets `waits` when it waits for the better one at rest, and `enough` when it needs none. `note` gets
    the operation and the delay of the first answer.
    """

    def __init__(self, note: Callable[[Operation, float], object] = lambda *_: None) -> None:
        self.first: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.waits, self.enough = asyncio.Event(), asyncio.Event()
        self._note = note

    def hear(self, first: Any, operation: Operation, delay_s: float) -> None:
        """Take the first answer."""
        self.first.set_result(first)
        self._note(operation, delay_s)


@dataclass(kw_only=True, eq=False)
class OpenCall:
    """A started call as the drone follows it: methods wait in the mission's thread, coroutines run on the loop.

    Where the mission makes one call at a time, the call `is_alone`. `took_s` is the time until it was over.
    """

    operation: Operation
    method: Method
    thread: MissionThread
    journal: Journal
    photos: AnsweredPhotos
    waypoint: int | None
    photo: NumberedPhoto | None
    is_alone: bool
    # Both from `begin` on.
    task: asyncio.Task[Any] = field(init=False)
    hearing: Hearing = field(init=False)
    is_dropped: bool = field(default=False, init=False)
    took_s: float = field(default=0.0, init=False)
    _has_begun: bool = field(default=False, init=False)
    _is_taken: bool = field(default=False, init=False)

    @property
    def needs_server(self) -> bool:
        """Whether only servers compute the call."""
        return self.method.patience is not None

    def begin(self, work: Coroutine[Any, Any, Any], hearing: Hearing) -> None:
        """Begin the work, on the loop, before the mission's next verb."""
        begun_s = now_s()

        def note_end(task: asyncio.Task[Any]) -> None:
            self.took_s = now_s() - begun_s
            if not task.cancelled():
                task.exception()  # retrieved: asyncio reports no failure that the mission never asks for

        self.task, self.hearing, self._has_begun = begin(work), hearing, True
        self.task.add_done_callback(note_end)

    @property
    def is_over(self) -> bool:
        """Whether the call has ended, with an answer or without; for any thread."""
        return self._has_begun and self.task.done()

    @property
    def has_first(self) -> bool:
        """Whether the first of two answers is there."""
        return self._has_begun and self.hearing.first.done()

    @property
    def failure(self) -> str:
        """Why the call is over without an answer; "" while it is open, and with an answer."""
        return why_failed(self.task) if self.task.done() else ""

    def wait(self, *, first: bool = False) -> float:
        """Wait until the last answer, or the `first`, is there or will never be; return for how many seconds."""
        return self.thread.call(self._waited_s(first=True) if first else self.over())

    async def over(self) -> float:
        """As `wait`, on the loop."""
        self.hearing.waits.set()
        return await self._waited_s()

    async def _waited_s(self, *, first: bool = False) -> float:
        begun_s = now_s()
        answers = [self.task, self.hearing.first] if first else [self.task]
        if not any(answer.done() for answer in answers):
            await asyncio.wait(answers, return_when=asyncio.FIRST_COMPLETED)
        return now_s() - begun_s

    def end(self) -> None:
        """Have no better answer come, and return when the call is over."""
        if not self.is_over:
            self.thread.call(self._ended())

    async def _ended(self) -> None:
        self.hearing.enough.set()
        await self._waited_s()

    def drop(self) -> None:
        """Drop the answer; the computation goes on."""
        self.is_dropped = True
        self.thread.post(lambda: self.hearing.enough.set())  # noqa: PLW0108 - the loop makes it

    @property
    def reply(self) -> Any:
        """The last reply that is there; raises the call's exception."""
        return self.task.result() if self.task.done() else self.hearing.first.result()

    def answer_of(self, reply: Any) -> Any:
        """The answer in a reply; raises the call's exception."""
        answer = self.method.result(reply)
        self.photos.answered(answer, self.photo)
        return answer

    def hand_over(self) -> Any:
        """The last answer that is there, for the mission's program."""
        self.photos.hand_over(self.photo)
        return self.answer_of(self.reply)

    def look(self, see: Callable[[], T]) -> T:
        """Have the mission's program look at the answer."""
        with self.photos.looking_at(self.photo):
            return see()

    def take(self, waited_s: float, *, demanded: bool = False) -> None:
        """Log, once, that the mission has the answer or the failure."""
        if not self._is_taken:
            self._is_taken = True
            self.note(
                schema.AnswerTaken(
                    waypoint=self.waypoint, waited_s=waited_s, demanded=demanded, failed=self.failure
                )
            )

    def note(self, event: schema.Event) -> None:
        """Log an event about the answer."""
        self.thread.post(lambda: self.journal.record(event))


def why_failed(call: asyncio.Task[Any]) -> str:
    """Why a call that is over has no answer; "" if it has one."""
    error = None if call.cancelled() else call.exception()
    return "" if error is None else message_of(error) or type(error).__name__


class Demand(Generic[T]):
    """A question about a coming answer; True is a demand. A failed call counts as one, as its answer is unknown.

    The question runs for the first of two answers, and again for a better one. Without a question the mission only
    tells the answer: none is a demand, and no failure.
    """

    def __init__(self, call: OpenCall, question: Callable[[T], object] | None = None) -> None:
        self.call = call
        self.only_tells = question is None
        self._question = question
        self._holds: bool | None = None  # None before the question
        self._asked: object = None  # its last reply

    @property
    def is_heard(self) -> bool:
        """Whether the question has run."""
        return self._holds is not None

    @property
    def is_due(self) -> bool:
        """Whether the question has not run for an answer that is there, or the call is over."""
        return self.call.is_over or (self._holds is None and self.call.has_first)

    @property
    def news(self) -> set[asyncio.Future[Any]]:
        """Futures: the first that is done makes the question due."""
        call = self.call
        return {call.task} if self._holds is not None else {call.task, call.hearing.first}

    def note(self) -> None:
        """Log the answer's demand, before the drone flies back to its waypoint."""
        self.call.note(schema.Demanded(waypoint=self.call.waypoint, failed=self.call.failure))

    def holds(self) -> bool:
        """Whether the last answer makes the question true; the question runs once for each answer."""
        question = self._question
        if question is None:
            self._holds = False
            return False
        try:
            reply = self.call.reply
            if self._holds is not None and reply is self._asked:
                return self._holds
            self._asked, answer = reply, self.call.answer_of(reply)
        except Unanswered:
            self._holds = False  # there is nothing to act on
        except Exception:  # noqa: BLE001 - it is raised where the mission takes the answer
            self._holds = True
        else:
            self._holds = bool(self.call.look(lambda: question(answer)))
        return self._holds


class Pending(Generic[T]):
    """A call that was started and whose answer may come later; `Drone.start` returns it.

    A call with two answers has a first one, and is over with the better one, or at its deadline.
    """

    def __init__(self, call: OpenCall) -> None:
        self.call = call  # as the drone follows it

    def done(self) -> bool:
        """Whether the call has ended, with an answer or without; for any thread."""
        return self.call.is_over

    def result(self) -> T:
        """Waits for the answer and returns it; raises the call's exception."""
        waited_s = self.call.wait()
        try:
            return cast(T, self.call.hand_over())
        finally:
            self.call.take(waited_s)

    def first(self) -> T:
        """Waits for the first of two answers, which the drone computes at once, and returns it.

        Where the call is over before, or has one answer, this is that answer; the call's exception is raised.
        """
        self.call.wait(first=True)
        return cast(T, self.call.hand_over())

    def cancel(self) -> None:
        """Drops the answer. The computation goes on, and the mission's next call waits for its end."""
        self.call.drop()

    def demands(self, question: Callable[[T], object] = bool) -> Demand[T]:
        """The argument `unless` of `Vehicle.goto`: stop the flight if `question(answer)` is true."""
        return Demand(self.call, question)
