"""PROGRAM: runs each service call on the drone or on a server, and looks for servers in the background.

core/selection/ decides. decisions.py passes what is decided about servers on to the radios (radios.py); calls are
made and raced by calling.py. A defect in any of these ends offloading and is logged; from then on every call runs on
the drone, and the mission goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NoReturn, TypeVar

from upwash.core.geo import Circle
from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.planning.acts import LateAct
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.backlog import Stay
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.policies.policy import Remote, Wait
from upwash.core.selection.deadlines import Deadlines
from upwash.core.selection.events import NoMoreCalls, SelectionEvent
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.selection import Selection
from upwash.drone.before_sending import BeforeSending
from upwash.drone.calling import CallAnswer, Calling, Invocation, Twice
from upwash.drone.decisions import Background, Decisions, now_s
from upwash.drone.line import AT_ONCE, CallLine, Turn
from upwash.drone.onboard import OnboardServices
from upwash.drone.own_policy import OwnPolicy
from upwash.drone.pending import Hearing
from upwash.drone.radios import RadioWorker, RadioWorkers
from upwash.drone.server_calls import ServerCalls
from upwash.drone.server_session import ServerEndpoint
from upwash.errors import TransitionError, UpwashError
from upwash.eventlog import schema
from upwash.ports import Dialer, Journal, Network, Whereabouts
from upwash.rpc.service import Method
from upwash.support.background import end, first, start
from upwash.support.text import printable, worded

T = TypeVar("T")


class Offloading:
    """Makes one drone's calls, and selects, checks and leaves servers for them.

    Calls are made one at a time. With `first`, the order of waiting calls, several may be open at the same time.
    `waiting_bytes` has the services that only servers run, with the bound of their waiting requests.
    """

    def __init__(
        self,
        selection: Selection,
        endpoints: Mapping[str, ServerEndpoint],
        *,
        period_s: float,
        autopilot: Whereabouts,
        networks: Sequence[Network],
        dialer: Dialer,
        onboard: OnboardServices,
        journal: Journal,
        hedging: Hedging,
        deadlines: Deadlines,
        before_sending: BeforeSending,
        first: Literal["oldest", "newest"] | None = None,
        waiting_bytes: Mapping[str, int] = MappingProxyType({}),
    ) -> None:
        self._journal = journal
        self._radios = RadioWorkers(
            [
                RadioWorker(
                    lambda server: selection.servers[server].in_range,
                    endpoints,
                    network=network,
                    dialer=dialer,
                    journal=journal,
                    tell=lambda event: self._decisions.tell(event),  # noqa: PLW0108 - they are made below
                    told=lambda: self._decisions.told(),  # noqa: PLW0108 - likewise
                )
                for network in networks
            ]
        )
        self._decisions = Decisions(selection, autopilot=autopilot, journal=journal, send=self._radios.send)
        self._looks = Background(
            self._decisions,
            [server.area for server in selection.servers.values() if isinstance(server.area, Circle)],
            period_s=period_s,
            autopilot=autopilot,
            journal=journal,
        )
        self._calling = Calling(
            self._decisions,
            self._radios,
            onboard,
            journal,
            hedging,
            deadlines=deadlines,
            before_sending=before_sending,
        )
        self._line = CallLine(self._decisions, first=first) if first else None
        self.server_calls = (
            ServerCalls(
                self._decisions,
                self._calling,
                self._line,
                journal,
                tell=self.tell,
                reach_s=self._reach_s,
                most_bytes=waiting_bytes,
            )
            if self._line is not None
            else None
        )
        self._failed = ""  # by what defect
        self._background: asyncio.Task[Any] | None = None

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
            if isinstance(policy := self._decisions.selection.policy, OwnPolicy):
                policy.end()

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use, and the round-trip time (s) of the last request to its daemon; None if unknown."""
        current = self._decisions.selection.current
        if self._failed or current is None:
            return None, None
        return current.name, self._radios.worker_at(current.name).round_trip_s(current.name)

    def outlook(self) -> Outlook | None:
        """What flying on before the open call is over would save and cost; None if nothing is known."""
        return self._guarded(self._decisions.outlook)

    def believed(self, operations: Sequence[Operation]) -> Mapping[str, ServerBelief]:
        """The servers that may compute these operations, and the mean seconds of a call at each."""
        return self._guarded(lambda: self._decisions.believed(operations)) or {}

    def where_to_wait(self, stay: Stay) -> str | None:
        """The server of the range where a resting drone waits for answers; None for where it is."""
        return self._guarded(lambda: self._decisions.selection.policy.where_to_wait(stay))

    def when_to_act(self, act: LateAct) -> int | None:
        """The number of a gap of the act, where the drone acts then; None for at once."""
        return self._guarded(lambda: self._decisions.selection.policy.when_to_act(act))

    def tell(self, event: SelectionEvent) -> None:
        """Pass the event to the core, and carry out its commands."""
        self._guarded(lambda: self._decisions.tell(event))

    def _reach_s(self, operation: Operation) -> float | None:
        return self._guarded(lambda: self._decisions.reach_s(operation))

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
        asked, asked_s, fails = (
            Invocation(operation, method, request, waypoint=waypoint),
            now_s(),
            bool(self._failed),
        )
        if method.patience is not None:
            return await self._invoke_at_server(asked, hearing, asked_s, urgent=urgent)
        while not fails and not method.once:
            try:
                async with self._turn(asked, urgent=urgent) as turn:
                    if not self._failed:
                        return await self._invoke(asked, turn, hearing, asked_s=asked_s)
            except Exception as error:
                if isinstance(error, UpwashError) and not isinstance(error, TransitionError):
                    raise
                self._fail(error)
            fails = True
        async with self._turn(asked, urgent=urgent) as turn:
            turn.take(None)
            return await self._invoke_alone(asked, began_s=asked_s if self._line else now_s())

    def _turn(self, asked: Invocation, *, urgent: bool) -> contextlib.AbstractAsyncContextManager[Turn]:
        if self._line is None:
            return contextlib.nullcontext(AT_ONCE)
        return self._line.turn(asked.operation, urgent=urgent, on_drone=asked.method.once)

    async def _run(self) -> NoReturn:
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._looks.look())
                tasks.create_task(self._looks.watch_borders())
                for worker in self._radios.workers:
                    tasks.create_task(worker.run())
        finally:
            await self._calling.stop_losers()
        raise AssertionError("these tasks never end by themselves")

    async def _leave(self) -> None:
        await self._calling.stop_losers()
        self._decisions.tell(NoMoreCalls())
        await self._radios.done()

    async def _invoke(self, asked: Invocation, turn: Turn, hearing: Hearing, *, asked_s: float) -> Any:
        began_s = now_s()
        decision = self._decisions.decide(
            asked.operation,
            waypoint=asked.waypoint,
            on_drone=turn.on_drone,
            drone_is_busy=turn.drone_is_busy,
        )
        call = asked.lighter(decision.inputs.lightened)
        wait: Literal["", "paid off", "failed"] = ""
        why = decision.why
        two = self._decisions.two_answers(call.operation)
        if isinstance(decision, Wait) and two is None:
            decision = await self._decisions.wait(call.operation, decision, waypoint=call.waypoint)
            wait = "paid off" if isinstance(decision, Remote) else "failed"
            why = f"{why}: {decision.why}"
        waited_s = now_s() - began_s
        turn.take(decision)
        if two is None:
            answer = await self._calling.answer(decision, call, turn)
        else:
            twice = Twice(
                call.under(two.first), asked_s + two.within_s, hearing, turn, asked_s, call.operation
            )
            answer = await self._calling.answer_twice(decision, call, twice)
        if two is not None:
            why += _of_two(answer, is_first=answer.call is not call)
        elif answer.server is None and isinstance(decision, Remote):
            why = f"{why}; {_lost(answer)} on the drone"
        elif answer.overtook:
            why = f"{why}; {answer.server} became of use, and was sooner"
        if answer.attempt is not None:
            why += answer.attempt.told_of_sending
        asked_for: dict[str, Any] = lightened.facts if (lightened := answer.call.lightened) else {}
        if two is not None and answer.call is not call:
            asked_for = {"asked": str(call.operation)}
        self._journal.record(
            schema.Call(
                waypoint=call.waypoint,
                operation=str(answer.call.operation),
                place=name_of(answer.server),
                check=answer.attempt.check if answer.attempt is not None else None,
                decision=why,
                at_s=asked_s,
                delay_s=now_s() - asked_s,
                waited_s=waited_s,
                onboard_s=answer.onboard_s,
                wait=wait,
                fell_back=answer.fell_back,
                hedged_s=answer.hedged_s,
                second_s=answer.attempt.second_s if answer.attempt is not None else None,
                queued_s=began_s - asked_s + answer.queued_s or None,
                remote_fault=answer.remote_fault,
                first_s=answer.first_s,
                **(answer.attempt.facts_of_sending if answer.attempt else {}),
                **asked_for,
            )
        )
        return answer.reply

    async def _invoke_at_server(
        self, asked: Invocation, hearing: Hearing, asked_s: float, *, urgent: bool
    ) -> Any:
        assert self.server_calls is not None  # noqa: S101 - with such a service there is a line
        if not self._failed:
            try:
                return await self.server_calls.answer(asked, hearing, urgent=urgent)
            except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
                self._fail(error)
        return self.server_calls.unanswered(asked, self._failed, asked_s)

    async def _invoke_alone(self, asked: Invocation, *, began_s: float) -> Any:
        """Run a call on the drone and decide nothing: where deciding has failed, or the method runs once."""
        await self._calling.queue(asked.operation.service)
        queued_s = now_s() - began_s
        reply = await self._calling.onboard(asked)
        delay_s = now_s() - began_s
        self._journal.record(
            schema.Call(
                waypoint=asked.waypoint,
                operation=str(asked.operation),
                place=ON_DRONE,
                decision="it runs once, and on the drone" if asked.method.once else self._failed,
                at_s=began_s,
                delay_s=delay_s,
                waited_s=0.0,
                onboard_s=delay_s - queued_s,
                wait="",
                fell_back=False,
                queued_s=queued_s or None,
            )
        )
        return reply

    def _guarded(self, do: Callable[[], T]) -> T | None:
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
        if self._line is not None:
            self._line.keep_on_drone()
        if self.server_calls is not None:
            self.server_calls.end(self._failed)
        if self._background is not None:
            self._background.cancel()
        trace = "".join(traceback.format_exception(error))
        self._journal.record(schema.OffloadingFailed(why=why, trace=trace))


def _of_two(answer: CallAnswer, *, is_first: bool) -> str:
    if is_first:
        return "; the first answer counts, as no better one came"
    return "" if answer.first_s is None else f"; the better answer, of {answer.server}"


def _lost(answer: CallAnswer) -> str:
    if answer.remote_fault:
        return f"it raised there, which was {answer.remote_fault}"
    return "no usable answer, so" if answer.fell_back else "late, and sooner"
