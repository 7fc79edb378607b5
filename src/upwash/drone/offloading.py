"""PROGRAM: runs each service call on the drone or on a server, and looks for servers in the background.

core/call/ and core/selection/ decide; this carries their instructions out, and tells them what has come of it. A
defect in any of these ends offloading and is logged; from then on every call runs on the drone, and the mission goes
on.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import traceback
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn, TypeAlias, TypeVar

from msgspec import Struct

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing, hangs_after_s
from upwash.core.call.call import Call
from upwash.core.call.calls import Calls
from upwash.core.call.steps import Asked, CallEvent, Instruction
from upwash.core.geo import Circle
from upwash.core.operation import ON_DRONE, Operation
from upwash.core.selection.events import NoMoreCalls, SelectionEvent
from upwash.core.selection.server_planning import ServerPlanning
from upwash.drone.before_sending import BeforeSending, NotReduced
from upwash.drone.looks import Looks
from upwash.drone.onboard import OnboardServices
from upwash.drone.own_policy import OwnPolicy
from upwash.drone.pending import Hearing
from upwash.drone.radios import RadioWorker, RadioWorkers
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import (
    UNREACHED,
    DeadlineExceeded,
    LinkError,
    NoLease,
    NotBegun,
    TransitionError,
    UpwashError,
)
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import Dialer, Finder, Journal, Network, Runtime, Whereabouts
from upwash.rpc.service import Method, NoAnswer, Reply
from upwash.support.background import begin, end, first, now_s, start
from upwash.support.text import printable, worded

T = TypeVar("T")
Work: TypeAlias = Attempt | Computing


class CallPorts(Struct, frozen=True, kw_only=True):
    """The ports that calls need; `networks` has one for each radio, `finder` looks up addresses."""

    autopilot: Whereabouts
    networks: Sequence[Network]
    dialer: Dialer
    onboard_dialer: Dialer
    onboard_runtime: Runtime
    journal: Journal
    finder: Finder | None = None


class _Defect(Exception):
    """Deciding has failed in a call that is open."""


@dataclass(slots=True, eq=False)
class _Open:
    method: Method
    request: bytes
    hearing: Hearing
    answer: asyncio.Future[Any]
    made_s: float
    # Decoded; or the failure of the drone's own service.
    replies: dict[Work, Any] = field(default_factory=dict)
    tasks: dict[Work, asyncio.Task[None]] = field(default_factory=dict)
    visits: dict[Attempt, tuple[RadioWorker, ServerSession]] = field(default_factory=dict)
    smaller: dict[Attempt, bytes] = field(default_factory=dict)  # requests

    def request_of(self, work: Work) -> bytes:
        return self.request_as(work.operation, work.call.asked.operation)

    def request_as(self, operation: Operation, asked: Operation) -> bytes:
        return self.request if operation == asked else self.method.under(operation.key, self.request)


class Offloading:
    """Makes one drone's calls, and selects, checks and leaves servers for them.

    Calls are made one at a time. Where they stand in line, `several` may be open at the same time.
    """

    def __init__(
        self,
        calls: Calls,
        endpoints: Mapping[str, ServerEndpoint],
        ports: CallPorts,
        onboard: OnboardServices,
        before_sending: BeforeSending,
        *,
        period_s: float,
    ) -> None:
        selection = calls.selection
        self._calls, self._selection = calls, selection
        self._autopilot, self._journal = ports.autopilot, ports.journal
        self._onboard, self._before_sending = onboard, before_sending
        self.several = calls.lanes.has_line
        self._radios = RadioWorkers(
            [
                RadioWorker(
                    lambda server: selection.servers[server].in_range,
                    endpoints,
                    network=network,
                    dialer=ports.dialer,
                    journal=ports.journal,
                    tell=self.tell,
                    told=self.happened,
                )
                for network in ports.networks
            ]
        )
        self._looks = Looks(
            self.tell,
            lambda: selection.next_look_s(now_s=now_s()),
            [server.area for server in selection.servers.values() if isinstance(server.area, Circle)],
            period_s=period_s,
            autopilot=ports.autopilot,
            journal=ports.journal,
        )
        self._open: dict[Call, _Open] = {}  # with those whose losers go on
        # Of the calls of each service, where deciding has failed.
        self._alone = defaultdict[str, asyncio.Lock](asyncio.Lock)
        self._news: asyncio.Event | None = None  # of the core, where a coroutine waits for it
        self._look_due: asyncio.Handle | None = None
        self._alarm: asyncio.TimerHandle | None = None
        self._failed = ""  # by what defect
        self._background: asyncio.Task[Any] | None = None

    async def start(self) -> None:
        """Start the drone's own services; raises InstanceError if one cannot run at all."""
        await self._onboard.start()
        await self._before_sending.start()

    async def close(self) -> None:
        """End the drone's own services."""
        await self._before_sending.close()
        await self._onboard.close()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look for servers and visit them until the end of the block; then leave the selected server."""
        background = self._background = start(self._run(), name="offloading", failed=self._fail)
        try:
            yield
        finally:
            if not background.done():  # else there is nothing left that could leave the server
                try:
                    await first(self._leave(), asyncio.wait([background]))
                except Exception as error:  # noqa: BLE001 - the mission was flown all the same
                    self._fail(error)
            await end(background)
            await self._end_work()
            if isinstance(policy := self._selection.policy, OwnPolicy):
                policy.end()

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use, and the round-trip time (s) of the last request to its daemon; None if unknown."""
        current = self._selection.current
        if self._failed or current is None:
            return None, None
        return current.name, self._radios.worker_at(current.name).round_trip_s(current.name)

    def waiting(self) -> list[Operation]:
        """The operations of the open calls that only servers compute, the oldest first."""
        return [call.asked.operation for call in self._open if call.asked.on_servers and not call.is_over]

    def reach_s(self, operation: Operation) -> float | None:
        """Seconds until a server in range answers a call that only servers compute; None where none can."""
        return self.ask(lambda: self.planning.reach_s(operation))

    @property
    def planning(self) -> ServerPlanning:
        """What is expected of the servers from here on."""
        self._selection.locate(self._autopilot.position, now_s())
        return self._selection.planning

    def tell(self, event: CallEvent | SelectionEvent) -> None:
        """Pass the event to the core, and carry out its instructions."""
        self._happens(event, now_s())

    async def invoke(
        self,
        operation: Operation,
        method: Method,
        request: bytes,
        waypoint: int | None = None,
        *,
        urgent: bool = False,
        hearing: Hearing,
    ) -> Any:
        """Runs one call where it is decided to run, and on the drone when that fails; returns its decoded reply.

        Of several open calls, the log has the `waypoint` of each; an `urgent` call comes before the others. A call
        with two answers tells the first to `hearing`, and returns the last.
        Nothing is decided of a method that runs once, so that no defect has it run again. Raises InstanceError only
        when the drone's own service fails too. A call that only servers compute may end without an answer.
        """
        patience = method.patience
        opened = _Open(method, request, hearing, asyncio.get_running_loop().create_future(), now_s())
        asked = Asked(
            operation,
            lambda other: len(opened.request_as(other, operation)),
            waypoint,
            urgent=urgent,
            once=method.once,
            on_servers=patience is not None,
            within_s=patience.within_s if patience is not None else None,
        )
        call, listening = Call(asked, is_waited_for=hearing.waits.is_set()), None
        if asked.on_servers or self._selection.two_answers:
            listening = begin(self._listen(call, hearing))
        try:
            if not self._failed:
                self._open[call] = opened
                self.tell(steps.Made(call))
                with contextlib.suppress(_Defect):
                    return await opened.answer
            if patience is None:
                return await self._invoke_alone(asked, opened)
            self._journal.record(
                schema.Unanswered(
                    waypoint=waypoint,
                    operation=str(operation),
                    at_s=opened.made_s,
                    waited_s=now_s() - opened.made_s,
                    within_s=asked.within_s,
                    why=self._failed,
                )
            )
            return NoAnswer(self._failed)
        finally:
            if not call.is_over:  # the mission has ended, or deciding has failed
                self.tell(steps.Abandoned(call))
                call.is_over = True
            self._forget(call)
            await end(listening)

    async def _listen(self, call: Call, hearing: Hearing) -> None:
        """Tell the core when the mission waits for the call, and when it needs no better answer."""
        await first(hearing.waits.wait(), hearing.enough.wait())
        if not hearing.enough.is_set():
            self.tell(steps.Waited(call))
            await hearing.enough.wait()
        self.tell(steps.Enough(call))

    async def _run(self) -> NoReturn:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._looks.look())
            tasks.create_task(self._looks.watch_borders())
            for worker in self._radios.workers:
                tasks.create_task(worker.run())
        raise AssertionError("these tasks never end by themselves")

    async def _leave(self) -> None:
        await self._end_work()
        self.tell(NoMoreCalls())
        await self._radios.done()

    # --- the core -------------------------------------------------------------------------------------------

    def _happens(self, event: CallEvent | SelectionEvent, at_s: float) -> None:
        if self._failed:
            return
        calls, told, news = self._calls, self._calls.told, self._calls.news
        try:
            for step in calls.handle(event, now_s=at_s, position=self._autopilot.position):
                self._perform(step)
            if calls.told > told:  # so that the next look may have moved
                self._looks.set_alarm()
            if calls.news > news:
                self._note_news()
            self._set_alarm()
        except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
            self._fail(error)

    def _note_news(self) -> None:
        if self._news is not None:
            self._news.set()
            self._news = None
        if self._look_due is None and self._calls.await_news:
            self._look_due = asyncio.get_running_loop().call_soon(self._look_at_calls)

    def _look_at_calls(self) -> None:
        self._look_due = None
        self.tell(steps.Recheck())

    def _set_alarm(self) -> None:
        due_s = self._calls.due_s
        if self._alarm is not None:
            if self._alarm.when() == due_s:
                return
            self._alarm.cancel()
        loop = asyncio.get_running_loop()
        self._alarm = loop.call_at(due_s, self._ring, due_s) if due_s < math.inf else None

    def _ring(self, due_s: float) -> None:
        self._alarm = None
        self._happens(steps.Recheck(), max(due_s, now_s()))

    async def happened(self) -> None:
        """Return after the next event of the core."""
        self._news = self._news or asyncio.Event()
        await self._news.wait()

    def _perform(self, step: Instruction) -> None:
        match step:
            case Event():
                self._journal.record(step)
            case steps.Reduce(attempt) | steps.Send(attempt) | steps.Cut(attempt) | steps.Deny(attempt):
                self._visit(step, attempt)
            case steps.Compute(computing):
                self._work(computing, lambda: self._compute(step))
            case steps.Stop(work):
                if (task := self._open[work.call].tasks.get(work)) is not None:
                    task.cancel()
            case steps.Hear(computing, delay_s):
                opened = self._open[computing.call]
                opened.hearing.hear(opened.replies[computing], computing.operation, delay_s)
            case steps.Answer(call, source):
                self._answer(call, self._open[call].replies[source])
            case steps.LeftUnanswered(call, why):
                self._answer(call, NoAnswer(why))
            case steps.LookAgain():
                self._looks.again.set()
            case _:
                self._radios.send(step)

    def _answer(self, call: Call, reply: Any) -> None:
        answer = self._open[call].answer
        if not answer.done():  # else the mission has ended in the call
            _settle(answer, reply)

    # --- what it does ---------------------------------------------------------------------------------------

    def _visit(self, step: steps.Reduce | steps.Send | steps.Cut | steps.Deny, attempt: Attempt) -> None:
        """Do that at the attempt's server, by the session that it began in: later the radio may be elsewhere."""
        visits = self._open[attempt.call].visits
        if attempt not in visits:
            worker = self._radios.worker_at(attempt.server)
            assert worker.session is not None  # noqa: S101 - a server is READY only by its session
            visits[attempt] = worker, worker.session
        worker, session = visits[attempt]
        match step:
            case steps.Reduce():
                self._work(attempt, lambda: self._reduce(attempt))
            case steps.Send():
                self._work(attempt, lambda: self._send(step, session))
            case steps.Cut(_, cut):
                worker.cut = cut
            case steps.Deny():
                session.deny(attempt.operation.service)

    def _work(self, work: Work, doing: Callable[[], Coroutine[Any, Any, CallEvent]]) -> None:
        """Do it beside the mission, and tell the core what has come of it."""
        opened = self._open[work.call]

        def ended(task: asyncio.Task[None]) -> None:
            if (
                opened.tasks.get(work) is task
            ):  # else the part before sending has ended, and the request is sent
                del opened.tasks[work]
            self._forget(work.call)

        task = opened.tasks[work] = begin(self._do(work, doing, opened))
        task.add_done_callback(ended)

    async def _do(
        self, work: Work, doing: Callable[[], Coroutine[Any, Any, CallEvent]], opened: _Open
    ) -> None:
        try:
            self.tell(await doing())
        except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
            # Only what must not run twice fails with it.
            opened.replies[work] = error if work.call.asked.once else _Defect()
            self._fail(error)
        if self._failed and isinstance(work, Computing):
            self._end_alone(work, opened)

    def _forget(self, call: Call) -> None:
        opened = self._open.get(call)
        if opened is not None and call.is_over and not opened.tasks:
            del self._open[call]

    async def _end_work(self) -> None:
        await end(*(task for opened in self._open.values() for task in opened.tasks.values()))

    async def _reduce(self, attempt: Attempt) -> steps.RequestReduced:
        opened = self._open[attempt.call]
        request = opened.request_of(attempt)
        try:
            smaller = await self._before_sending.reduce(
                attempt.operation.service, opened.method, request, deadline_s=attempt.deadline_s
            )
        except NotReduced as error:
            return steps.RequestReduced(attempt, len(request), is_less=False, why=str(error))
        opened.smaller[attempt] = smaller
        return steps.RequestReduced(attempt, len(smaller), is_less=smaller is not request)

    async def _send(self, send: steps.Send, session: ServerSession) -> CallEvent:
        attempt, opened = send.attempt, self._open[send.attempt.call]
        operation = attempt.operation
        try:
            answer = await session.call(
                operation.service,
                operation.method,
                opened.smaller.get(attempt) or opened.request_of(attempt),
                deadline_s=send.deadline_s,
                may_queue_s=send.may_queue_s,
            )
            reply = opened.replies[attempt] = opened.method.decode(answer)
        except NotBegun as told:
            return steps.TurnedAway(attempt, str(told), told.queue_s)
        except NoLease as error:
            return steps.SlotLost(attempt, str(error))
        except LinkError as error:
            is_cut, is_unreached = isinstance(error, DeadlineExceeded), isinstance(error, UNREACHED)
            return steps.Failed(attempt, str(error), cut=is_cut, unreached=is_unreached)
        raised, size_bytes = opened.method.raised(reply), len(answer)
        if isinstance(answer, Reply):
            return steps.Replied(attempt, size_bytes, raised, answer.queued_s, answer.queue_s)
        return steps.Replied(attempt, size_bytes, raised)

    async def _compute(self, compute: steps.Compute) -> steps.Computed:
        computing, opened = compute.computing, self._open[compute.computing.call]
        try:
            request = opened.request_of(computing)
            reply = await self._onboard_reply(opened.method, computing.operation, request, compute.timeout_s)
        except TransitionError:
            raise
        except UpwashError as error:
            opened.replies[computing] = error
            return steps.Computed(computing, failed=True)
        opened.replies[computing] = reply
        return steps.Computed(computing, opened.method.raised(reply))

    async def _onboard_reply(
        self, method: Method, operation: Operation, request: bytes, timeout_s: float
    ) -> Any:
        service, name, once = operation.service, operation.method, method.once
        return method.decode(await self._onboard.call(service, name, request, timeout_s=timeout_s, once=once))

    # --- without the core -----------------------------------------------------------------------------------

    async def _invoke_alone(self, asked: Asked, opened: _Open) -> Any:
        """Run a call on the drone and decide nothing, where deciding has failed."""
        operation = asked.operation
        if under_way := [
            task
            for other in self._open.values()
            for work, task in other.tasks.items()
            if isinstance(work, Computing) and work.operation.service == operation.service
        ]:
            await asyncio.wait(under_way)
        async with self._alone[operation.service]:
            began_s, timeout_s = now_s(), hangs_after_s(self._selection.estimates.local_s(operation))
            reply = await self._onboard_reply(opened.method, operation, opened.request, timeout_s)
        self._log_alone(asked, operation, opened.made_s, began_s)
        return reply

    def _end_alone(self, computing: Computing, opened: _Open) -> None:
        if opened.answer.done():
            return
        reply = opened.replies[computing]
        if not isinstance(reply, Exception):
            began_s = computing.began_s or opened.made_s
            self._log_alone(computing.call.asked, computing.operation, opened.made_s, began_s)
        _settle(opened.answer, reply)

    def _log_alone(self, asked: Asked, operation: Operation, made_s: float, began_s: float) -> None:
        self._journal.record(
            schema.Call(
                waypoint=asked.waypoint,
                operation=str(operation),
                place=ON_DRONE,
                decision=self._failed,
                at_s=made_s,
                delay_s=now_s() - made_s,
                waited_s=0.0,
                onboard_s=now_s() - began_s,
                wait="",
                fell_back=False,
                queued_s=began_s - made_s or None,
            )
        )

    def ask(self, do: Callable[[], T]) -> T | None:
        """What the core, or the policy, says; None once deciding has failed."""
        if not self._failed:
            try:
                return do()
            except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
                self._fail(error)
        return None

    def _fail(self, error: BaseException) -> None:
        if self._failed:
            return
        defect: BaseException = error
        while isinstance(defect, BaseExceptionGroup):
            defect = defect.exceptions[0]
        why = worded(defect)
        self._failed = f"offloading has failed: {printable(why)}"
        if self._background is not None:
            self._background.cancel()
        trace = "".join(traceback.format_exception(error))
        self._journal.record(schema.OffloadingFailed(why=why, trace=trace))
        for opened in self._open.values():
            computed = [work for work in opened.tasks if isinstance(work, Computing)]
            for work in opened.tasks.keys() - set(computed):
                opened.tasks[work].cancel()
            # Where the drone computes the call, that answer counts: the call must not run twice.
            if not computed and not opened.answer.done():
                opened.answer.set_exception(_Defect())


def _settle(answer: asyncio.Future[Any], reply: Any) -> None:
    if isinstance(reply, Exception):
        answer.set_exception(reply)
    else:
        answer.set_result(reply)
