"""A mission's calls, one at a time, with an answer at once or later, and the demands of late answers.

    stay    wait, then act at the waypoint
    go      fly the next leg; after a demand on the way brake, fly back, act, and set off again. At the next waypoint
            do all that comes before the next call, then wait, and fly one leg back if the answer has a demand

`AnswerAction` and `AnswerActions` run in the mission's thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, cast

from msgspec import Struct

from upwash.core.geo import Position, Waypoint
from upwash.core.operation import Operation
from upwash.core.planning.stay_or_go import Outlook, StayRule
from upwash.drone.mission import MissionThread
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import Journal
from upwash.rpc.service import Method, request_of
from upwash.support.background import begin, end

P = ParamSpec("P")
T = TypeVar("T")

Invoke = Callable[[Operation, Method, bytes], Coroutine[Any, Any, Any]]


class StartedCall:
    """A call that the mission has begun; the loop makes its task before the mission's next verb."""

    def __init__(self) -> None:
        self.task: asyncio.Task[Any] | None = None

    @property
    def is_over(self) -> bool:
        """Whether the call has ended, with a reply or without."""
        return self.task is not None and self.task.done()

    async def over(self) -> float:
        """Waits until the call has ended; returns the seconds waited. For the loop."""
        begun_s = asyncio.get_running_loop().time()
        if self.task is not None and not self.task.done():
            await asyncio.wait((self.task,))
        return asyncio.get_running_loop().time() - begun_s

    @property
    def reply(self) -> Any:
        """The decoded reply of the ended call; raises InstanceError if the drone's own service failed too."""
        assert self.task is not None  # noqa: S101 - it is over
        return self.task.result()

    @property
    def failure(self) -> str:
        """Why the ended call has no reply; "" if it has one."""
        assert self.task is not None  # noqa: S101 - it is over
        error = None if self.task.cancelled() else self.task.exception()
        return "" if error is None else str(error) or type(error).__name__


class Pending(Generic[T]):
    """A call that was started and whose answer may come later; `Drone.start` returns it."""

    def __init__(self, calls: Calls, call: StartedCall, method: Method, waypoint: int | None) -> None:
        self._calls = calls
        self._call = call
        self._method = method
        self._waypoint = waypoint
        self._is_taken = False

    def done(self) -> bool:
        """Whether the call has ended, with an answer or without; for any thread."""
        return self._call.is_over

    def result(self) -> T:
        """Waits for the answer and returns it; raises the call's exception."""
        waited_s = self._calls.wait(self._call)
        try:
            return self._answer()
        finally:
            self._take(waited_s)

    def cancel(self) -> None:
        """Drops the answer. The computation goes on, and the mission's next call waits for its end."""
        self._calls.drop(self._call)

    def demands(self, question: Callable[[T], object] = bool) -> Demand[T]:
        """The argument `unless` of `Vehicle.goto`: stop the flight if `question(answer)` is true."""
        return Demand(self, question)

    def _wait(self) -> float:
        """Waits until the call has ended; returns the seconds waited."""
        return self._calls.wait(self._call)

    def _take(self, waited_s: float, *, demanded: bool = False) -> None:
        """Logs, once, that the mission has the answer or the failure."""
        if not self._is_taken:
            self._is_taken = True
            self._calls.note(
                schema.AnswerTaken(
                    waypoint=self._waypoint,
                    waited_s=waited_s,
                    demanded=demanded,
                    failed=self._call.failure,
                )
            )

    def _note_demand(self) -> None:
        """Logs the answer's demand, before the drone flies back to its waypoint."""
        self._calls.note(schema.Demanded(waypoint=self._waypoint, failed=self._call.failure))

    async def _answered(self) -> None:
        await self._call.over()

    def _answer(self) -> T:
        return cast(T, self._method.result(self._call.reply))


class Demand(Generic[T]):
    """A question about a coming answer; True is a demand. A failed call counts as one, as its answer is unknown."""

    def __init__(self, pending: Pending[T], question: Callable[[T], object]) -> None:
        self.pending = pending
        self._question = question
        self._holds: bool | None = None  # None before the question

    async def answered(self) -> None:
        """Return when the call has ended; for the loop."""
        await self.pending._answered()

    def note(self) -> None:
        """Log the answer's demand, before the drone flies back to its waypoint."""
        self.pending._note_demand()

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


_NONE = StartedCall()  # no call at all


class Calls:
    """Makes the mission's calls, from its thread; `waypoint` returns the drone's waypoint, None off the plan."""

    def __init__(
        self, thread: MissionThread, invoke: Invoke, journal: Journal, *, waypoint: Callable[[], int | None]
    ) -> None:
        self._thread = thread
        self._invoke = invoke
        self._journal = journal
        self._waypoint = waypoint
        self._under_way = self._dropped = _NONE

    def call(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Makes a call and waits for its decoded reply; UsageError while another call is pending."""
        self._require_free(operation)
        after, self._dropped = self._dropped, _NONE
        return self._thread.call(self._run(operation, method, request, after))

    def start(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Makes a call of a service's method with these arguments, and does not wait.

        Raises UsageError while another call is pending, or if `call` is no method of an object from `Drone.service`.
        """
        operation, method, request = request_of(call, args, kwargs)
        self._require_free(operation)
        started, after, waypoint = StartedCall(), self._dropped, self._waypoint()

        def on_loop() -> None:
            self._journal.record(schema.CallStarted(operation=str(operation), waypoint=waypoint))
            started.task = begin(self._run(operation, method, request, after))
            started.task.add_done_callback(_take_note)

        self._under_way, self._dropped = started, _NONE
        self._thread.post(on_loop)
        return Pending(self, started, method, waypoint)

    def wait(self, call: StartedCall) -> float:
        """Waits until the call is over; returns the seconds waited."""
        return self._thread.call(call.over())

    def drop(self, call: StartedCall) -> None:
        """Drop the answer of the call."""
        if self._under_way is call:
            self._under_way, self._dropped = _NONE, call

    def on_loop(self, do: Callable[[], T]) -> T:
        """Calls `do` on the loop's thread and returns its result."""

        async def verb() -> T:
            return do()

        return self._thread.call(verb())

    def note(self, event: Event) -> None:
        """Logs an event of the mission."""
        self._thread.post(lambda: self._journal.record(event))

    async def close(self) -> None:
        """Ends calls that are still under way; for the loop, after the mission's last call."""
        await end(self._under_way.task, self._dropped.task)

    def _require_free(self, operation: Operation) -> None:
        self._thread.require_turn()
        if self._under_way is not _NONE and not self._under_way.is_over:
            raise UsageError(
                f"{operation} cannot be called yet: another call is pending, and a drone makes one at a time; take "
                "its answer first, with its result(), or drop it with cancel()"
            )

    async def _run(self, operation: Operation, method: Method, request: bytes, after: StartedCall) -> Any:
        await after.over()
        return await self._invoke(operation, method, request)


def _take_note(call: asyncio.Task[Any]) -> None:
    """Retrieve the exception, so that asyncio reports no failure that the mission never asks for."""
    if not call.cancelled():
        call.exception()


Place = Waypoint | Position


def index_of(place: Place | None) -> int | None:
    """The index of a waypoint; None for a position."""
    return place.index if isinstance(place, Waypoint) else None


class VehicleVerbs(Struct, frozen=True):
    """The vehicle's functions that settling an answer needs.

    `fly` returns False, at rest on the way, if the answer has a demand before the arrival. After `leave_open` the
    following verbs settle the answer.
    """

    place: Callable[[], Place | None]  # where it was last sent to
    position: Callable[[], Position]
    fly: FlyVerb
    leave_open: Callable[[AnswerAction[Any]], None]


class FlyVerb(Protocol):
    """Flies to a place; `back` to a waypoint whose calls are over."""

    def __call__(self, place: Place, *, unless: Demand[Any] | None = None, back: bool = False) -> bool:
        """Return whether the vehicle has arrived."""


@dataclass(frozen=True, slots=True)
class DemandedAction(Generic[T]):
    """What to do after an answer: call `act(answer)` at the place if `demands(answer)` is true.

    `failed` gets an exception of the call there; without `failed` the mission does.
    """

    pending: Pending[T]
    act: Callable[[T], object]
    demands: Callable[[T], object]
    failed: Callable[[Exception], object] | None
    place: Place | None

    @property
    def waypoint(self) -> int | None:
        """The waypoint of the place; None for a position."""
        return index_of(self.place)


class AnswerAction(Generic[T]):
    """One demanded action, from the call until the action is done."""

    def __init__(
        self, action: DemandedAction[T], vehicle: VehicleVerbs, calls: Calls, rule: StayRule
    ) -> None:
        self._action = action
        self._vehicle = vehicle
        self._calls = calls
        self._rule = rule
        self._demand = action.pending.demands(action.demands)
        self.is_away = False  # whether the drone has left the waypoint
        self.is_over = False

    def settle(self) -> None:
        """Waits for the answer; if it has a demand, flies to its waypoint, acts, and comes back here."""
        here, waited_s = self._vehicle.place(), self._action.pending._wait()
        if self.is_away and self._demand.holds():
            self._action.pending._note_demand()
            self._come_back(waited_s)
            if here is not None:
                self._vehicle.fly(here)
        else:
            self._finish(waited_s)

    def fly_on(self, place: Place) -> None:
        """Fly one leg with the answer open; wait for it before another leg."""
        if self.is_away:
            self.settle()
            self._vehicle.fly(place)
            return
        self.is_away = True
        if not self._vehicle.fly(place, unless=self._demand):
            self._come_back(0.0)
            self._vehicle.fly(place)
        elif self._action.pending.done():  # in the moment of the arrival, or demanding nothing
            self.settle()

    def _come_back(self, waited_s: float) -> None:
        action = self._action
        self._calls.note(schema.TurnedBack(waypoint=action.waypoint, position=self._vehicle.position()))
        if action.place is not None:
            self._vehicle.fly(action.place, back=True)
        self._finish(waited_s)

    def _finish(self, waited_s: float) -> None:
        self.is_over = True
        action = self._action
        demanded = self._demand.holds()
        self._rule.answered(demanded=demanded)
        action.pending._take(waited_s, demanded=demanded)
        if not demanded:
            return
        try:
            answer = action.pending._answer()
        except Exception as error:
            if action.failed is None:
                raise
            action.failed(error)
        else:
            action.act(answer)
        self._calls.note(schema.Acted(waypoint=action.waypoint))


class AnswerActions:
    """Settles each answer, at once or on the way, as the rule decides; for the mission's thread."""

    def __init__(
        self, vehicle: VehicleVerbs, calls: Calls, *, rule: StayRule, outlook: Callable[[], Outlook | None]
    ) -> None:
        self._vehicle = vehicle
        self._calls = calls
        self._rule = rule
        self._outlook = outlook

    def run(self, action: DemandedAction[Any]) -> None:
        """Waits for the answer and acts on it, or leaves it open and returns."""
        answer = AnswerAction(action, self._vehicle, self._calls, self._rule)
        if self._goes(action):
            self._vehicle.leave_open(answer)
        else:
            answer.settle()

    def _goes(self, action: DemandedAction[Any]) -> bool:
        if self._rule.manner == "stay" or action.pending.done():
            return False
        verdict = self._calls.on_loop(lambda: self._rule.decide(self._outlook()))
        self._calls.note(
            schema.StayOrGo(
                waypoint=action.waypoint,
                goes=verdict.goes,
                why=verdict.why,
                chance=verdict.chance,
                saved_s=verdict.saved_s,
                lost_s=verdict.lost_s,
            )
        )
        return verdict.goes
