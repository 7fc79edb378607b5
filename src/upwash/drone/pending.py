"""A mission's calls, one at a time, with an answer at once or later, and the demands of late answers.

    stay    wait, then act at the waypoint
    go      fly the next leg; after a demand on the way brake, fly back, act, and set off again. At the next waypoint
            do all that comes before the next call, then wait, and fly one leg back if the answer has a demand

`AnswerAction` and `AnswerActions` run in the mission's thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, cast

from msgspec.structs import asdict

from upwash.core.geo import Position, Waypoint, distance_m
from upwash.core.operation import Operation
from upwash.core.planning.stay_or_go import Outlook, StayRule, StayVerdict
from upwash.drone.mission import MissionThread
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import Journal
from upwash.rpc.service import Method, request_of
from upwash.support.background import begin, end

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
    ) -> Coroutine[Any, Any, Any]:
        """The decoded reply."""


class Pending(Generic[T]):
    """A call that was started and whose answer may come later; `Drone.start` returns it."""

    def __init__(self, calls: Calls, method: Method, waypoint: int | None) -> None:
        self._calls = calls
        self._method = method
        self._waypoint = waypoint
        self._task: asyncio.Task[Any] | None = None  # the loop makes it before the mission's next verb
        self._is_taken = False
        self.took_s = 0.0  # until it was over

    def done(self) -> bool:
        """Whether the call has ended, with an answer or without; for any thread."""
        return self._task is not None and self._task.done()

    def result(self) -> T:
        """Waits for the answer and returns it; raises the call's exception."""
        waited_s = self._wait()
        try:
            return self._answer()
        finally:
            self._take(waited_s)

    def cancel(self) -> None:
        """Drops the answer. The computation goes on, and the mission's next call waits for its end."""
        self._calls.drop(self)

    def demands(self, question: Callable[[T], object] = bool) -> Demand[T]:
        """The argument `unless` of `Vehicle.goto`: stop the flight if `question(answer)` is true."""
        return Demand(self, question)

    async def _over(self) -> float:
        """Returns once the answer is there, or will never be, after how many seconds; for the loop."""
        begun_s = asyncio.get_running_loop().time()
        assert self._task is not None  # noqa: S101 - the loop has made it
        if not self._task.done():
            await asyncio.wait((self._task,))
        return asyncio.get_running_loop().time() - begun_s

    def _wait(self) -> float:
        """The same for the mission."""
        return self._calls.do(self._over())

    def _answer(self) -> T:
        assert self._task is not None  # noqa: S101 - it is over
        return cast(T, self._method.result(self._task.result()))

    @property
    def _failure(self) -> str:
        assert self._task is not None  # noqa: S101 - it is over
        return why_failed(self._task)

    def _take(self, waited_s: float, *, demanded: bool = False) -> None:
        """Logs, once, that the mission has the answer or the failure."""
        if not self._is_taken:
            self._is_taken = True
            self._calls.note(
                schema.AnswerTaken(
                    waypoint=self._waypoint, waited_s=waited_s, demanded=demanded, failed=self._failure
                )
            )


def why_failed(call: asyncio.Task[Any]) -> str:
    """Why a call that is over has no answer; "" if it has one."""
    error = None if call.cancelled() else call.exception()
    return "" if error is None else str(error) or type(error).__name__


class Demand(Generic[T]):
    """A question about a coming answer; True is a demand. A failed call counts as one, as its answer is unknown."""

    def __init__(self, pending: Pending[T], question: Callable[[T], object]) -> None:
        self.pending = pending
        self._question = question
        self._holds: bool | None = None  # None before the question

    async def answered(self) -> None:
        """Return when the call has ended; for the loop."""
        await self.pending._over()

    def note(self) -> None:
        """Log the answer's demand, before the drone flies back to its waypoint."""
        pending = self.pending
        pending._calls.note(schema.Demanded(waypoint=pending._waypoint, failed=pending._failure))

    def holds(self) -> bool:
        """Whether the answer of the ended call makes the question true; the question runs once."""
        if self._holds is None:
            try:
                answer = self.pending._answer()
            except Exception:  # noqa: BLE001 - it is raised where the mission takes the answer
                self._holds = True
            else:
                self._holds = bool(self._question(answer))
        return self._holds


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
        several: bool = False,
    ) -> None:
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
        return self.do(self._run(operation, method, request, after, self._waypoint(), urgent=True))

    def start(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Makes a call of a service's method with these arguments, and does not wait.

        Raises UsageError while another call is pending, or if `call` is no method of an object from `Drone.service`.
        """
        operation, method, request = request_of(call, args, kwargs)
        self._require_free(operation)
        after, waypoint = self._dropped, self._waypoint()
        started = Pending[T](self, method, waypoint)

        def on_loop() -> None:
            self._journal.record(schema.CallStarted(operation=str(operation), waypoint=waypoint))
            begun_s = asyncio.get_running_loop().time()

            def note_end(call: asyncio.Task[Any]) -> None:
                started.took_s = asyncio.get_running_loop().time() - begun_s
                _take_note(call)

            started._task = begin(self._run(operation, method, request, after, waypoint))
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

    def do(self, verb: Coroutine[Any, Any, T]) -> T:
        """Does that on the loop's thread, and waits for it."""
        return self._thread.call(verb)

    def note(self, event: Event) -> None:
        """Logs an event of the mission."""
        self._thread.post(lambda: self._journal.record(event))

    async def close(self) -> None:
        """Ends calls that are still under way; for the loop, after the mission's last call."""
        calls = (self._under_way, self._dropped, *self._others)
        await end(*(call._task for call in calls if call is not None))

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
        waypoint: int | None,
        *,
        urgent: bool = False,
    ) -> Any:
        if after is not None:
            await after._over()
        if not self._several:
            return await self._invoke(operation, method, request)
        return await self._invoke(operation, method, request, waypoint, urgent=urgent)


def _take_note(call: asyncio.Task[Any]) -> None:
    """Retrieve the exception, so that asyncio reports no failure that the mission never asks for."""
    if not call.cancelled():
        call.exception()


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

    def fly(self, place: Place, *, unless: Demand[Any] | None = None, back: bool = False) -> bool:
        """Fly to a place, `back` to a waypoint whose calls are over; False, at rest on the way, for a demand."""

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Have the verbs that follow settle the answer."""


class AnswerAction(Generic[T]):
    """What to do about an answer, from the call on until it is done: `act`, at its place, if the answer demands it.

    An exception of the call goes to `failed` there, or to the mission without `failed`.
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
        self.is_away = False  # whether the drone has left the waypoint
        self.is_over = False
        self._is_noted = False

    def settle(self) -> None:
        """Waits for the answer; if it has a demand, flies to its waypoint, acts, and comes back here."""
        here, waited_s = self._vehicle.place(), self.pending._wait()
        if self.is_away and self.demand.holds():
            self.demand.note()
            self.come_back(waited_s)
            if here is not None:
                self._vehicle.fly(here)
        else:
            self.finish(waited_s)

    def fly_on(self, place: Place) -> None:
        """Fly one leg with the answer open; wait for it before another leg."""
        if self.is_away:
            self.settle()
            self._vehicle.fly(place)
            return
        self.is_away = True
        if not self._vehicle.fly(place, unless=self.demand):
            self.come_back(0.0)
            self._vehicle.fly(place)
        elif self.pending.done():  # in the moment of the arrival, or demanding nothing
            self.settle()

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
        demanded = self.demand.holds()
        place = position_of(self.place) if self.place is not None else None
        self._rule.answered(self.pending.took_s, demanded=demanded, place=place)
        self.pending._take(waited_s, demanded=demanded)
        if not demanded:
            return
        try:
            answer = self.pending._answer()
        except Exception as error:
            if self._failed is None:
                raise
            self._failed(error)
        else:
            self._act(answer)
        self._calls.note(schema.Acted(waypoint=self.waypoint))


async def one_answered(answers: Iterable[AnswerAction[Any]]) -> None:
    """Return when the call of one of the answers has ended; there must be an answer. For the loop."""
    calls = [answer.pending._task for answer in answers]
    await asyncio.wait([call for call in calls if call is not None], return_when=asyncio.FIRST_COMPLETED)


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
        answer = AnswerAction(self._vehicle, self._calls, self._rule, demand, act, failed=failed)
        if self._vehicle.flies_rows:
            self._vehicle.leave_open(answer)
            return
        if self._rule.manner != "stay" and not demand.pending.done():
            verdict = self._calls.do(self._judge(answer.place))
            self._calls.note(schema.StayOrGo(waypoint=answer.waypoint, **asdict(verdict)))
            if verdict.goes:
                self._vehicle.leave_open(answer)
                return
        answer.settle()

    async def _judge(self, place: Place | None) -> StayVerdict:
        return self._rule.decide(self._outlook(), position_of(place) if place is not None else None)
