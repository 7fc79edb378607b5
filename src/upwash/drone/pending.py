"""A mission's calls, one at a time, with an answer at once or later, and the demands of late answers.

    stay    wait, then act at the waypoint
    go      fly the next leg; after a demand on the way brake, fly back, act, and set off again. At the next waypoint
            do all that comes before the next call, then wait, and fly one leg back if the answer has a demand

`AnswerAction` and `AnswerActions` run in the mission's thread.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Iterable
from functools import partial
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, cast

import msgspec
from msgspec.structs import asdict

from upwash.core.geo import Position, Waypoint, distance_m
from upwash.core.operation import Operation
from upwash.core.planning.stay_or_go import Outlook, StayRule, StayVerdict
from upwash.drone.answered_photos import AnsweredPhotos, NumberedPhoto
from upwash.drone.mission import MissionThread
from upwash.drone.objects import FlightObjects
from upwash.errors import Unanswered, UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import Journal
from upwash.rpc.service import Method, request_of
from upwash.support.background import begin, end
from upwash.support.text import message_of

P = ParamSpec("P")
T = TypeVar("T")


class Invoke(Protocol):
    """Makes one call; of several open calls the log has the `waypoint`, and an urgent one comes first."""

    def __call__(
        self,
        operation: Operation,
        method: Method,
        request: bytes,
        waypoint: int | None = None,
        *,
        urgent: bool = False,
        hearing: Hearing,
    ) -> Coroutine[Any, Any, Any]:
        """The decoded reply; of two answers the last, and `hearing` gets the first."""


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


class Pending(Generic[T]):
    """A call that was started and whose answer may come later; `Drone.start` returns it.

    A call with two answers has a first one, and is over with the better one, or at its deadline.
    """

    def __init__(
        self,
        calls: Calls,
        operation: Operation,
        method: Method,
        *,
        waypoint: int | None,
        photo: NumberedPhoto | None,
    ) -> None:
        self._calls = calls
        self.operation = operation
        self._method = method
        self._waypoint = waypoint
        self.photo = photo
        self._task: asyncio.Task[Any]  # the loop makes both before the mission's next verb
        self._hearing: Hearing
        self._is_taken = False
        self.took_s = 0.0  # until it was over
        self.needs_server = method.patience is not None

    def done(self) -> bool:
        """Whether the call has ended, with an answer or without; for any thread."""
        return hasattr(self, "_task") and self._task.done()

    def result(self) -> T:
        """Waits for the answer and returns it; raises the call's exception."""
        waited_s = self._wait()
        try:
            return self._handed_over()
        finally:
            self._take(waited_s)

    def first(self) -> T:
        """Waits for the first of two answers, which the drone computes at once, and returns it.

        Where the call is over before, or has one answer, this is that answer; the call's exception is raised.
        """
        self._calls.do(self._heard())
        return self._handed_over()

    def cancel(self) -> None:
        """Drops the answer. The computation goes on, and the mission's next call waits for its end."""
        self._calls.drop(self)

    def demands(self, question: Callable[[T], object] = bool) -> Demand[T]:
        """The argument `unless` of `Vehicle.goto`: stop the flight if `question(answer)` is true."""
        return Demand(self, question)

    def _looked_at(self) -> contextlib.AbstractContextManager[None]:
        """A block during which the mission's program looks at the answer."""
        return self._calls.photos.looking_at(self.photo)

    async def _over(self) -> float:
        """Returns once the last answer is there, or will never be, after how many seconds; for the loop."""
        begun_s = asyncio.get_running_loop().time()
        self._hearing.waits.set()
        if not self._task.done():
            await asyncio.wait((self._task,))
        return asyncio.get_running_loop().time() - begun_s

    async def _heard(self) -> float:
        """The same of the first answer."""
        begun_s = asyncio.get_running_loop().time()
        if not (self._task.done() or self._hearing.first.done()):
            await asyncio.wait((self._task, self._hearing.first), return_when=asyncio.FIRST_COMPLETED)
        return asyncio.get_running_loop().time() - begun_s

    def _wait(self) -> float:
        """The same for the mission."""
        return self._calls.do(self._over())

    def _handed_over(self) -> T:
        """The last answer that is there, for the mission's program."""
        self._calls.photos.hand_over(self.photo)
        return self._answer()

    def _answer(self) -> T:
        return self._answer_of(self._reply())

    def _answer_of(self, reply: Any) -> T:
        """The answer in a reply; raises the call's exception."""
        answer = self._method.result(reply)
        self._calls.photos.answered(answer, self.photo)
        return cast(T, answer)

    def _reply(self) -> Any:
        return self._task.result() if self._task.done() else self._hearing.first.result()

    @property
    def _has_first(self) -> bool:
        return hasattr(self, "_hearing") and self._hearing.first.done()

    @property
    def _failure(self) -> str:
        return why_failed(self._task) if self._task.done() else ""

    async def _ended_now(self) -> None:
        """Have no better answer come, and return when the call is over; for the loop."""
        self._hearing.enough.set()
        await asyncio.wait((self._task,))

    def _take(self, waited_s: float, *, demanded: bool = False) -> None:
        """Logs, once, that the mission has the answer or the failure."""
        if not self._is_taken:
            self._is_taken = True
            self._calls.note(
                schema.AnswerTaken(
                    waypoint=self._waypoint,
                    waited_s=waited_s,
                    demanded=demanded,
                    failed=self._failure,
                )
            )


def why_failed(call: asyncio.Task[Any]) -> str:
    """Why a call that is over has no answer; "" if it has one."""
    error = None if call.cancelled() else call.exception()
    return "" if error is None else message_of(error) or type(error).__name__


class Demand(Generic[T]):
    """A question about a coming answer; True is a demand. A failed call counts as one, as its answer is unknown.

    The question runs for the first of two answers, and again for a better one.
    """

    def __init__(self, pending: Pending[T], question: Callable[[T], object]) -> None:
        self.pending = pending
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
        return self.pending.done() or (self._holds is None and self.pending._has_first)

    @property
    def news(self) -> set[asyncio.Future[Any]]:
        """Futures: the first that is done makes the question due."""
        pending = self.pending
        return {pending._task} if self._holds is not None else {pending._task, pending._hearing.first}

    async def answered(self) -> None:
        """Return when the question is due; for the loop."""
        await asyncio.wait(self.news, return_when=asyncio.FIRST_COMPLETED)

    @property
    def only_tells(self) -> bool:
        """Whether no answer is a demand."""
        return False

    def note(self) -> None:
        """Log the answer's demand, before the drone flies back to its waypoint."""
        pending = self.pending
        pending._calls.note(schema.Demanded(waypoint=pending._waypoint, failed=pending._failure))

    def holds(self) -> bool:
        """Whether the last answer makes the question true; the question runs once for each answer."""
        try:
            reply = self.pending._reply()
            if self._holds is not None and reply is self._asked:
                return self._holds
            self._asked, answer = reply, self.pending._answer_of(reply)
        except Unanswered:
            self._holds = False  # there is nothing to act on
        except Exception:  # noqa: BLE001 - it is raised where the mission takes the answer
            self._holds = True
        else:
            with self.pending._looked_at():
                self._holds = bool(self._question(answer))
        return self._holds


class NoDemand(Demand[T]):
    """Stands for the question about an answer that the mission only tells; a failed call demands nothing either."""

    def __init__(self, pending: Pending[T]) -> None:
        super().__init__(pending, lambda _: False)

    @property
    def only_tells(self) -> bool:
        """True."""
        return True

    def holds(self) -> bool:
        """False for every answer."""
        self._holds = False
        return False


class ActOnObject(Protocol):
    """An act on an object, which is over with the answers of the calls that it leaves open."""

    def begin_call(self) -> None:
        """Note that the act has left a call open."""

    def end_call(self, answer: AnswerAction[Any]) -> None:
        """Take the answer of that call, or its failure."""


class Calls:
    """Makes the mission's calls, from its thread; `waypoint` returns the drone's waypoint, None off the plan.

    With `several` they may be open at the same time.
    """

    def __init__(
        self,
        thread: MissionThread,
        invoke: Invoke,
        journal: Journal,
        *,
        waypoint: Callable[[], int | None],
        photos: AnsweredPhotos | None = None,
        objects: FlightObjects | None = None,
        several: bool = False,
    ) -> None:
        self.photos = photos or AnsweredPhotos()
        self.objects = objects or FlightObjects()
        self.acting: ActOnObject | None = None  # the act that is under way
        self._thread = thread
        self._invoke = invoke
        self._journal = journal
        self._waypoint = waypoint
        self._several = several
        self._under_way: Pending[Any] | None = None  # the last one, of several
        self._dropped: Pending[Any] | None = None
        self._others: list[Pending[Any]] = []  # of several; some are over

    def call(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Makes a call and waits for its decoded reply; UsageError while another call is pending."""
        self._require_free(operation)
        after, self._dropped = self._dropped, None
        photo = self._photo(method, request)
        self.photos.hand_over(photo)
        reply = self.do(self._run(operation, method, request, after, waypoint=self._waypoint()))
        self.photos.answered(getattr(reply, "value", None), photo)
        return reply

    def start(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Makes a call of a service's method with these arguments, and does not wait.

        Raises UsageError while another call is pending, or if `call` is no method of an object from `Drone.service`.
        """
        operation, method, request = request_of(call, args, kwargs)
        self._require_free(operation)
        after, waypoint = self._dropped, self._waypoint()
        started = Pending[T](self, operation, method, waypoint=waypoint, photo=self._photo(method, request))

        def on_loop() -> None:
            self._journal.record(schema.CallStarted(operation=str(operation), waypoint=waypoint))
            begun_s = asyncio.get_running_loop().time()

            def note_end(call: asyncio.Task[Any]) -> None:
                started.took_s = asyncio.get_running_loop().time() - begun_s
                if not call.cancelled():
                    call.exception()  # retrieved: asyncio reports no failure that the mission never asks for

            started._hearing = Hearing(partial(self.note_first, waypoint))
            started._task = begin(
                self._run(operation, method, request, after, waypoint=waypoint, hearing=started._hearing)
            )
            started._task.add_done_callback(note_end)

        if self._several and self._under_way is not None:
            self._others = [call for call in self._others if not call.done()] + [self._under_way]
        self._under_way, self._dropped = started, None
        self._thread.post(on_loop)
        return started

    def drop(self, call: Pending[Any]) -> None:
        """Drop the answer of the call."""
        if self._under_way is call:
            self._under_way, self._dropped = None, call
        self._thread.post(lambda: call._hearing.enough.set())  # noqa: PLW0108 - the loop makes it

    def let_go(self, call: Pending[Any]) -> None:
        """Let the mission make its next call: end this call, where calls are made one at a time."""
        if not self._several and not call.done():
            self.do(call._ended_now())

    def beside_a_leg(self, is_beside: bool) -> contextlib.AbstractContextManager[None]:
        """A block during which the mission may only notify, if `is_beside`."""
        return self._thread.only_messages() if is_beside else contextlib.nullcontext()

    def do(self, verb: Coroutine[Any, Any, T]) -> T:
        """Does that on the loop's thread, and waits for it."""
        return self._thread.call(verb)

    def note_first(self, waypoint: int | None, operation: Operation, delay_s: float) -> None:
        """Logs the first of two answers; for the loop."""
        self._journal.record(schema.FirstAnswer(waypoint=waypoint, operation=str(operation), delay_s=delay_s))

    def note(self, event: Event) -> None:
        """Logs an event of the mission."""
        self._thread.post(lambda: self._journal.record(event))

    async def close(self) -> None:
        """Ends calls that are still under way; for the loop, after the mission's last call."""
        calls = (self._under_way, self._dropped, *self._others)
        await end(*(call._task for call in calls if call is not None))

    def _photo(self, method: Method, request: bytes) -> NumberedPhoto | None:
        try:
            return self.photos.of_call(method.arguments(request).values())
        except msgspec.MsgspecError:  # the service refuses them
            return self.photos.of_call(())

    def _require_free(self, operation: Operation) -> None:
        self._thread.require_turn()
        if not self._several and self._under_way is not None and not self._under_way.done():
            raise UsageError(
                f"{operation} cannot be called yet: another call is pending, and a drone makes one at a time; take "
                "its answer first, with its result(), or drop it with cancel()"
            )

    async def _run(
        self,
        operation: Operation,
        method: Method,
        request: bytes,
        after: Pending[Any] | None,
        *,
        waypoint: int | None,
        hearing: Hearing | None = None,
    ) -> Any:
        urgent = hearing is None
        if hearing is None:  # the mission waits
            hearing = Hearing(partial(self.note_first, waypoint))
            hearing.waits.set()
        if after is not None:
            await after._over()
        if not self._several:
            return await self._invoke(operation, method, request, hearing=hearing)
        return await self._invoke(operation, method, request, waypoint, urgent=urgent, hearing=hearing)


Place = Waypoint | Position


def position_of(place: Place) -> Position:
    """The position of a waypoint, or the position given."""
    return place.position if isinstance(place, Waypoint) else place


def index_of(place: Place | None) -> int | None:
    """The index of a waypoint; None for a position."""
    return place.index if isinstance(place, Waypoint) else None


class VehicleVerbs(Protocol):
    """What settling an answer does with the vehicle."""

    @property
    def flies_rows(self) -> bool:
        """Whether it flies rows without stopping, with several answers open."""

    def place(self) -> Place | None:
        """Where it was last sent to."""

    def position(self) -> Position:
        """Where it is."""

    def fly(
        self,
        place: Place,
        *,
        unless: Demand[Any] | None = None,
        late: AnswerAction[Any] | None = None,
        back: bool = False,
    ) -> bool:
        """Fly to a place, `back` to a waypoint whose calls are over; False, at rest on the way, for a demand.

        The act of a `late` answer may be put off.
        """

    def puts_off(self, answer: AnswerAction[Any]) -> bool:
        """Whether the act is put off, at rest at a waypoint."""

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Have the verbs that follow settle the answer."""

    def owe(self, act: AnswerAction[Any]) -> None:
        """Have the verbs that follow do the act, whose answer is there, or put it off."""


class AnswerAction(Generic[T]):
    """What to do about an answer, from the call on until it is done: `act`, at its place, if the answer demands it.

    An exception of the call goes to `failed` there, or to the mission without `failed`. With `NoDemand` `act` tells
    each answer, at any place, and only notifies.
    """

    def __init__(
        self,
        vehicle: VehicleVerbs,
        calls: Calls,
        rule: StayRule,
        demand: Demand[T],
        act: Callable[[T], object],
        *,
        failed: Callable[[Exception], object] | None,
    ) -> None:
        self._vehicle = vehicle
        self._calls = calls
        self._rule = rule
        self.demand = demand
        self.pending = demand.pending
        self._act = act
        self._failed = failed
        self.place = vehicle.place()
        self.waypoint = index_of(self.place)
        self.object: int | None = None  # the number of the object that is acted on
        self._of: ActOnObject | None = None  # the act that made the call
        self.is_away = False  # whether the drone has left the waypoint
        self.is_over = False  # the act is done, or put off
        self._is_noted = self._is_learnt = False

    def hear(self) -> bool:
        """Waits for the answer, of two for the first; acts on it, or returns False where a better one may come."""
        waited_s = self.pending._calls.do(self.pending._heard())
        if not self.demand.holds() and not self.pending.done():
            return False
        self.finish(waited_s)
        return True

    def settle(self, *, puts_off: bool = False) -> None:
        """Waits for the last answer; if it has a demand, flies to its waypoint, acts, and comes back here.

        The act may be put off, if the caller `puts_off` acts.
        """
        here, waited_s = self._vehicle.place(), self.pending._wait()
        if self.is_away and self.demands():
            if puts_off and self._vehicle.puts_off(self):
                return
            self.come_back(waited_s)
            if here is not None:
                self._vehicle.fly(here)
        else:
            self.finish(waited_s)

    def fly_on(self, place: Place) -> None:
        """Fly one leg with the answer open; wait for it before another leg."""
        if self.is_away and not self.only_tells:
            self.settle(puts_off=True)
            self._vehicle.fly(place)
            return
        self.is_away = True
        if not self._vehicle.fly(place, unless=self.demand, late=self):
            if not self.is_over:  # else its acts are done
                self.come_back(0.0)
            self._vehicle.fly(place)
        elif self.pending.done() and not self.is_over:  # in the moment of the arrival, or demanding nothing
            self.settle(puts_off=True)

    def demands(self) -> bool:
        """Whether the answer, which is there, has a demand; logs one."""
        holds = self.demand.holds()
        if holds and not self._is_noted:
            self._is_noted = True
            self.demand.note()
        return holds

    def away_m(self, here: Position) -> float:
        """How far its place is from here."""
        return 0.0 if self.place is None else distance_m(here, position_of(self.place))

    def come_back(self, waited_s: float) -> None:
        """Fly to its place, and act there."""
        self._calls.note(schema.TurnedBack(waypoint=self.waypoint, position=self._vehicle.position()))
        if self.place is not None:
            self._vehicle.fly(self.place, back=True)
        self.finish(waited_s)

    def finish(self, waited_s: float) -> None:
        """Take the answer, and act if it has a demand."""
        self.is_over = True
        if not self.pending.done():  # the first of two answers is acted on
            self._calls.do(self.pending._ended_now())
        self.learn()
        demanded = self.demand.holds()
        self.pending._take(waited_s, demanded=demanded)
        if self._of is not None:
            self._of.end_call(self)
        try:
            answer = self.pending._answer()
        except Exception as error:
            if self._failed is None:
                raise
            self._have_told(partial(self._failed, error))
        else:
            if demanded or self.only_tells:
                self._have_told(partial(self._act, answer))
        if demanded:
            self._calls.note(schema.Acted(waypoint=self.waypoint))

    def finish_on_ground(self) -> None:
        """The same after the landing."""
        self.finish(0.0)

    def answer_if_any(self) -> T | None:
        """The answer that is there; None if the call has failed."""
        try:
            return self.pending._answer()
        except Exception:  # noqa: BLE001 - it is raised where the mission takes the answer
            return None

    def belongs_to(self, act: ActOnObject | None) -> None:
        """Have the act that made the call go on until the answer is taken."""
        self._of = act
        if act is not None:
            act.begin_call()

    def _have_told(self, do: Callable[[], object]) -> None:
        """Have the mission do that about the answer; it may fly only where it acts."""
        with self.pending._looked_at(), self._calls.beside_a_leg(self.only_tells):
            do()

    def put_off(self) -> None:
        """Note that the act is put off: the answer is none that is waited for."""
        self.is_over = True
        self._calls.let_go(self.pending)
        self.learn()

    def learn(self) -> None:
        """Have the rule learn from the last answer, once."""
        if self._is_learnt or not self.pending.done():
            return
        if self.needs_server or self.only_tells:  # it says little of the answers that the drone may wait for
            return
        self._is_learnt = True
        place = position_of(self.place) if self.place is not None else None
        self._rule.answered(self.pending.took_s, demanded=self.demand.holds(), place=place)

    @property
    def is_held(self) -> bool:
        """Whether nothing is done about it for now."""
        return False

    @property
    def needs_server(self) -> bool:
        """Whether only servers compute the call."""
        return self.pending.needs_server

    @property
    def only_tells(self) -> bool:
        """Whether the drone does not wait or fly for the answer."""
        return self.demand.only_tells


async def one_answered(
    answers: Iterable[AnswerAction[Any]], *, waits: bool = False, within_s: float | None = None
) -> None:
    """Return when one of the calls has an answer that was not looked at; there must be a call. For the loop.

    With `waits` the drone rests meanwhile, so that no server comes nearer.
    """
    for answer in answers if waits else ():
        answer.pending._hearing.waits.set()
    news = set().union(*(answer.demand.news for answer in answers))
    await asyncio.wait(news, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)


class AnswerActions:
    """Settles each answer, at once or on the way, as the rule decides; for the mission's thread."""

    def __init__(
        self, vehicle: VehicleVerbs, calls: Calls, *, rule: StayRule, outlook: Callable[[], Outlook | None]
    ) -> None:
        self._vehicle = vehicle
        self._calls = calls
        self._rule = rule
        self._outlook = outlook

    def run(
        self, demand: Demand[T], act: Callable[[T], object], failed: Callable[[Exception], object] | None
    ) -> None:
        """Waits for the answer and acts on it, or leaves it open and returns."""
        self.take_up(self._action(demand, act, failed))

    def take_up(self, answer: AnswerAction[Any]) -> None:
        """Waits for the answer and settles it, or leaves it open and returns."""
        if self._vehicle.flies_rows or answer.needs_server:
            self._vehicle.leave_open(answer)
            return
        if self._rule.manner != "stay" and not answer.pending.done():
            verdict = self._calls.do(self._judge(answer.place))
            self._calls.note(schema.StayOrGo(waypoint=answer.waypoint, **asdict(verdict)))
            if verdict.goes:
                self._vehicle.leave_open(answer)
                return
        if not answer.hear():
            self._vehicle.leave_open(answer)

    def tell(
        self, pending: Pending[T], tell: Callable[[T], object], failed: Callable[[Exception], object] | None
    ) -> None:
        """Has the verbs that follow tell the answer, once it is there."""
        self._vehicle.leave_open(self._action(NoDemand(pending), tell, failed))

    def _action(
        self, demand: Demand[T], act: Callable[[T], object], failed: Callable[[Exception], object] | None
    ) -> AnswerAction[T]:
        answer = AnswerAction(self._vehicle, self._calls, self._rule, demand, act, failed=failed)
        answer.belongs_to(self._calls.acting)
        return answer

    async def _judge(self, place: Place | None) -> StayVerdict:
        return self._rule.decide(self._outlook(), position_of(place) if place is not None else None)
