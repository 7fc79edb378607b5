"""PROGRAM: runs each service call on the drone or on a server, and looks for servers in the background.

The deciding is done by core/selection.py; this carries its commands out and tells it what came of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import msgspec

from upwash.core.estimates import Operation
from upwash.core.happenings import (
    Happening,
    LocalCallEnded,
    Looked,
    MissionEnded,
    RemoteCallCut,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
)
from upwash.core.hedging import Hedge, Hedging
from upwash.core.orders import Check, Command, Leave, Order, Probe
from upwash.core.policy import Decision, Remote, Wait
from upwash.core.selection import Selection
from upwash.core.servers import Change, State
from upwash.envoy import Envoy, end_all
from upwash.errors import AutopilotLost, DeadlineExceeded, LinkError, UpwashError
from upwash.onboard import PLACE, OnboardServices
from upwash.ports import Autopilot, Dialer, Journal, Network
from upwash.service import Method
from upwash.visit import Contact, Visit

_LOCAL_LEAST_S = 30.0
_LOCAL_FACTOR = 10.0  # times the estimate: a local call that takes longer hangs


class Outcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """One call, as the mission experienced it; what has a default is not logged where it is that."""

    operation: Operation
    place: str  # "local" or the server's name
    decision: str
    at_s: float
    delay_s: float
    waited_s: float
    onboard_s: float  # of the delay, what the drone's own service took
    wait: str  # "", "paid off" or "failed"
    fell_back: bool
    hedged_s: float | None = None  # into the remote call, when the drone's own service started on it too
    queued_s: float = 0.0  # of the delay, until the drone's own service was done with an earlier call
    remote_fault: str = (
        ""  # where a server said that the service raised: "confirmed" or "denied" by the drone's own
    )


@dataclass(frozen=True, slots=True)
class _Answer:
    """What one call came to; the fields are those of an Outcome."""

    reply: Any
    place: str
    onboard_s: float = 0.0
    fell_back: bool = False
    hedged_s: float | None = None
    queued_s: float = 0.0
    remote_fault: str = ""
    overtook: bool = False  # a server that became of use while the drone was at it


@dataclass(frozen=True, slots=True)
class _Call:
    """What the mission asked for."""

    operation: Operation
    method: Method
    request: bytes


@dataclass(frozen=True, slots=True)
class _Said:
    """What a server says that the service raised in a call, and after how long."""

    raised: str
    delay_s: float


@dataclass(slots=True)
class _Computing:
    """The drone's own service at a call: first it may have to be done with an earlier one."""

    operation: Operation
    asked_s: float
    began_s: float | None = None
    task: asyncio.Task[Any] = field(init=False)


@dataclass(slots=True)
class _Attempt:
    """A call to a server, bound to the check that made it READY, and the drone's own service at the same call."""

    call: _Call
    server: str
    envoy: Envoy
    visit: Visit
    check: int
    deadline_s: float
    reply: asyncio.Task[Any] | None = None  # where it is not simply waited for
    rival: asyncio.Task[Any] | None = None
    said: _Said | None = None
    verdict: str = ""  # on what it said, as an Outcome's `remote_fault`

    @property
    def late(self) -> bool:
        """Whether the drone's own service has answered."""
        return self.rival is not None and _is_answered(self.rival)


@dataclass(frozen=True, slots=True)
class _Loser:
    """What still runs of a call that is answered; `service` is the drone's own that is busy with it, if one is."""

    task: asyncio.Task[Any]
    service: str | None = None


class Offloading:
    """One drone's calls and its business with servers."""

    def __init__(
        self,
        selection: Selection,
        contacts: Mapping[str, Contact],
        *,
        period_s: float,
        autopilot: Autopilot,
        networks: Sequence[Network],
        dialer: Dialer,
        onboard: OnboardServices,
        journal: Journal,
        hedging: Hedging | None = None,
    ) -> None:
        self._selection = selection
        self._period_s = period_s
        self._autopilot = autopilot
        self._onboard = onboard
        self._journal = journal
        self._hedging = hedging
        self._losers: list[_Loser] = []
        self._told = asyncio.Event()  # is set once something has happened
        self._envoys = [
            Envoy(selection, contacts, network=network, dialer=dialer, journal=journal, tell=self.tell)
            for network in networks
        ]
        self._sent: dict[str, Envoy] = {}  # by the server that they visit, or visited last
        self._visited: list[str] = []
        self._look_now = asyncio.Event()
        self._changed = asyncio.Event()

    async def run(self) -> NoReturn:
        """Looks for servers and visits them, until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._look())
                tasks.create_task(self._watch_borders())
                for envoy in self._envoys:
                    tasks.create_task(envoy.run())
        finally:
            await self._stop_losers()
        raise AssertionError("these tasks never end by themselves")

    async def end(self) -> None:
        """Leaves whatever server is selected; to be called while `run` runs, after the last call."""
        await self._stop_losers()
        self.tell(MissionEnded())
        for envoy in self._envoys:
            await envoy.done()

    async def invoke(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call where it is decided to run, and on the drone when that fails; returns its decoded reply.

        Raises InstanceError only when the drone's own service fails too.
        """
        began_s = self._now_s()
        decision, wait = self._decide(operation), ""
        why = decision.why
        if isinstance(decision, Wait):
            decision = await self._wait(operation, decision)
            wait = "paid off" if isinstance(decision, Remote) else "failed"
            why = f"{why}: {decision.why}"
        waited_s = self._now_s() - began_s
        answer = await self._answer(decision, _Call(operation, method, request))
        if answer.place == PLACE and isinstance(decision, Remote):
            why = f"{why}; {_lost(answer)} on the drone"
        elif answer.overtook:
            why = f"{why}; {answer.place} became of use, and was sooner"
        self._report(
            Outcome(
                operation,
                answer.place,
                why,
                began_s,
                self._now_s() - began_s,
                waited_s,
                answer.onboard_s,
                wait,
                answer.fell_back,
                answer.hedged_s,
                answer.queued_s,
                answer.remote_fault,
            )
        )
        return answer.reply

    async def invoke_alone(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call on the drone and decides nothing: where deciding has failed, or the method runs once."""
        began_s = self._now_s()
        queued_s = await self._queue(operation.service)
        reply = await self._call_onboard(_Call(operation, method, request))
        delay_s = self._now_s() - began_s
        why = "it runs once, and on the drone" if method.once else "offloading has failed"
        self._report(
            Outcome(
                operation,
                PLACE,
                why,
                began_s,
                delay_s,
                0.0,
                delay_s - queued_s,
                "",
                fell_back=False,
                queued_s=queued_s,
            )
        )
        return reply

    def _report(self, outcome: Outcome) -> None:
        facts = msgspec.to_builtins(outcome)
        if not outcome.queued_s:  # omitted by identity otherwise, which a computed zero has not
            facts.pop("queued_s", None)
        self._journal.record("call", **{**facts, "operation": str(outcome.operation)})

    # --- deciding -------------------------------------------------------------------------------------------

    def _decide(self, operation: Operation) -> Decision:
        decision, commands = self._selection.decide(
            operation, now_s=self._now_s(), position=self._autopilot.position
        )
        self._decided(operation, decision, commands)
        return decision

    async def _wait(self, operation: Operation, wait: Wait) -> Decision:
        check = self._selection.servers[wait.server].check
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(wait.at_most_s):
                while self._selection.is_checking(check):
                    await self._changed.wait()
        decision, commands = self._selection.decide_after_wait(
            operation, check, now_s=self._now_s(), position=self._autopilot.position
        )
        self._decided(operation, decision, commands)
        return decision

    def _decided(self, operation: Operation, decision: Decision, commands: Sequence[Command]) -> None:
        """Logs a decision with what it was made of, enough to make it again."""
        self._perform(commands)
        if commands:  # a server was left: look for another
            self._look_now.set()
        estimates, current = self._selection.estimates, self._selection.current
        self._journal.record(
            "decided",
            operation=str(operation),
            decision=type(decision).__name__.lower(),
            **msgspec.to_builtins(decision),
            local_s=estimates.local_s(operation),
            selected=current.name if current else None,
            state=current.state if current else None,
            remote_s=estimates.remote_s(current.name, operation) if current else None,
            check_s=estimates.check_s(current.name, running=current.state is State.CHECK_R)
            if current
            else None,
            check_elapsed_s=self._now_s() - current.checked_since_s if current else None,
            position=msgspec.to_builtins(self._autopilot.position),
        )

    def tell(self, happening: Happening) -> None:
        """Takes in what happened, and does what it calls for."""
        commands = self._selection.handle(happening, now_s=self._now_s(), position=self._autopilot.position)
        self._perform(commands)
        self._told.set()
        self._told = asyncio.Event()

    def _perform(self, commands: Sequence[Command]) -> None:
        for command in commands:
            if isinstance(command, Change):
                self._record_change(command)
            else:
                self._send(command)
        if commands:
            self._changed.set()
            self._changed = asyncio.Event()

    def _send(self, order: Order) -> None:
        """Gives the order to the envoy that visits the server, or to one that is free.

        Best to the one that was there last: it says goodbye, if it still has to, before it comes again.
        """
        if isinstance(order, (Check, Probe)) and order.server not in self._visited:
            busy = [self._sent[server] for server in self._visited]
            free = [envoy for envoy in self._envoys if envoy not in busy]
            last = self._sent.get(order.server)
            self._sent[order.server] = last if last in free else free[0]
            self._visited.append(order.server)
        self._sent[order.server].send(order)
        if isinstance(order, Leave):
            self._visited.remove(order.server)

    def _record_change(self, change: Change) -> None:
        estimates = self._selection.estimates
        self._journal.record(
            change.event,
            server=change.server,
            before=change.before,
            after=change.after,
            why=change.why,
            local_mean_call_s=estimates.mean_call_s(),
            mean_call_s={
                server.name: estimates.mean_call_s(server.name) for server in self._selection.in_range
            },
            position=msgspec.to_builtins(self._autopilot.position),
        )

    # --- calling --------------------------------------------------------------------------------------------

    async def _answer(self, decision: Decision, call: _Call) -> _Answer:
        local_s = self._selection.estimates.local_s(call.operation)
        if self._hedging is not None and local_s is not None:
            self._hedging.count(local_s)
        if not isinstance(decision, Remote):
            return await self._answer_onboard(call)
        if decision.raced:
            attempt = self._send_out(self._attempt(call, decision.server, decision.deadline_s))
            return await self._answer_onboard(call, instead_of=attempt)
        if (hedge := self._plan_hedge(decision, call.operation)) is not None:
            return await self._answer_hedged(decision, hedge, call)
        attempt = self._attempt(call, decision.server, decision.deadline_s)
        reply = await self._call_server(attempt)
        if reply is not None:
            return _Answer(reply, decision.server)
        return await self._answer_onboard(call, instead_of=attempt)

    def _attempt(self, call: _Call, server: str, deadline_s: float) -> _Attempt:
        envoy = self._sent[server]
        assert envoy.visit is not None  # noqa: S101 - a server is READY only by its visit
        return _Attempt(call, server, envoy, envoy.visit, self._selection.servers[server].check, deadline_s)

    def _send_out(self, attempt: _Attempt) -> _Attempt:
        """Begins the attempt, beside whatever else is done for the call."""
        attempt.reply = asyncio.create_task(self._call_server(attempt))
        return attempt

    async def _call_server(self, attempt: _Attempt) -> Any | None:
        """The decoded reply of a server that carries a value, or None where it gave no such reply."""
        call, server, began_s = attempt.call, attempt.server, self._now_s()
        operation, method = call.operation, call.method
        try:
            reply = method.decode(
                await attempt.visit.call(
                    operation.service, operation.method, call.request, deadline_s=attempt.deadline_s
                )
            )
        except LinkError as error:
            self._journal.record("remote_failed", server=server, why=str(error))
            if isinstance(error, DeadlineExceeded):
                attempt.envoy.cut = RemoteCallCut(server, operation, self._now_s() - began_s)
            self.tell(RemoteCallFailed(server, attempt.check, str(error), attempt.late))
            return None
        delay_s = self._now_s() - began_s
        if raised := method.raised(reply):
            attempt.said = _Said(raised, delay_s)
            self._doubt(attempt, attempt.said)
            return None
        if attempt.late:
            self._journal.record("dropped", operation=str(operation), place=server)
        if self._hedging is not None:
            self._hedging.answered(server, operation, delay_s)
        self.tell(RemoteCallEnded(server, operation, delay_s, attempt.late))
        return reply

    def _doubt(self, attempt: _Attempt, said: _Said) -> None:
        """Notes what the server says that the service raised; the mission hears only what the drone's own raises."""
        server, rival = attempt.server, attempt.rival
        operation = str(attempt.call.operation)
        self._journal.record("remote_raised", server=server, operation=operation, raised=said.raised)
        if rival is not None and attempt.late:
            self._test(attempt, rival.result())
        else:
            self.tell(RemoteCallRaised(server, f"{server} says that {operation} raised {said.raised}"))

    def _test(self, attempt: _Attempt, onboard: Any) -> None:
        """Holds what the server said, if it did, against what the drone's own service replied to the same call."""
        if (said := attempt.said) is None or attempt.verdict:
            return
        server, operation = attempt.server, attempt.call.operation
        confirmed = bool(attempt.call.method.raised(onboard))
        attempt.verdict = "confirmed" if confirmed else "denied"
        why = f"it says that {operation} raised {said.raised}, which did not raise on the drone"
        if not confirmed:
            self._journal.record("remote_failed", server=server, why=f"{server}: {why}")
        elif self._hedging is not None:
            self._hedging.answered(server, operation, said.delay_s)
        self.tell(RemoteFaultTested(server, attempt.check, operation, said.delay_s, why, confirmed))

    async def _answer_onboard(self, call: _Call, *, instead_of: _Attempt | None = None) -> _Answer:
        """Has the drone compute the call, and each server that is of use before the drone is done."""
        return await self._race(call, self._begin_onboard(call), instead_of)

    async def _race(self, call: _Call, computing: _Computing, attempt: _Attempt | None) -> _Answer:
        """The first answer; the loser runs on, as a computation cannot be broken off, and its answer is dropped.

        `attempt` is the last one at a server, which is over, or under way where it has a `reply`.
        """
        overtaking = False
        try:
            while True:
                if attempt is not None and attempt.reply is not None:
                    attempt.rival = computing.task
                    if await _first_over(attempt.reply, computing.task) is attempt.reply:
                        return replace(self._won(attempt, computing), overtook=overtaking)
                if computing.task.done() or (attempt is not None and attempt.said is not None):
                    break
                decision = await self._overtaken(computing, call.operation)
                if decision is None:
                    break
                attempt, overtaking = (
                    self._send_out(self._attempt(call, decision.server, decision.deadline_s)),
                    True,
                )
            reply = await asyncio.shield(computing.task)
        except BaseException:
            under_way = [attempt.reply] if attempt is not None and attempt.reply is not None else []
            await end_all([computing.task, *under_way])
            raise
        return self._done_onboard(reply, computing, attempt)

    async def _overtaken(self, computing: _Computing, operation: Operation) -> Remote | None:
        """Which server is to be at the call too, as soon as one is of use; None where the drone is done before."""
        if not self._selection.overtakes:
            return None
        while not computing.task.done():
            now_s, position = self._now_s(), self._autopilot.position
            decision, again_s = self._selection.overtake(
                operation,
                began_s=now_s if computing.began_s is None else computing.began_s,
                now_s=now_s,
                position=position,
            )
            if decision is not None:
                self._decided(operation, decision, ())
                return decision
            told = asyncio.create_task(self._told.wait())
            left_s = again_s - now_s if again_s < math.inf else None
            try:
                await asyncio.wait(
                    (computing.task, told), timeout=left_s, return_when=asyncio.FIRST_COMPLETED
                )
            finally:
                told.cancel()
        return None

    def _begin_onboard(self, call: _Call) -> _Computing:
        computing = _Computing(call.operation, self._now_s())

        async def compute() -> Any:
            await self._queue(call.operation.service)
            computing.began_s = self._now_s()
            return await self._call_onboard(call)

        computing.task = asyncio.create_task(compute())
        return computing

    def _done_onboard(self, reply: Any, computing: _Computing, attempt: _Attempt | None) -> _Answer:
        """The drone's own answer, which was first; `attempt` is the last one at a server, if any was made."""
        began_s = computing.asked_s if computing.began_s is None else computing.began_s
        delay_s = self._now_s() - began_s
        late = attempt is not None and attempt.reply is not None and not attempt.reply.done()
        if attempt is not None:
            self._test(attempt, reply)
            if late and attempt.reply is not None:
                self._keep(_Loser(attempt.reply))
        self.tell(LocalCallEnded(computing.operation, delay_s))
        return _Answer(
            reply,
            PLACE,
            delay_s,
            fell_back=attempt is not None and not late,
            queued_s=began_s - computing.asked_s,
            remote_fault=attempt.verdict if attempt is not None else "",
        )

    def _won(self, attempt: _Attempt, computing: _Computing) -> _Answer:
        """The server's answer, which was first."""
        assert attempt.reply is not None  # noqa: S101 - it has answered
        now_s, operation = self._now_s(), computing.operation
        began_s = now_s if computing.began_s is None else computing.began_s
        if computing.began_s is None:
            computing.task.cancel()  # it was still in line
        else:
            drop = asyncio.create_task(self._drop(operation, computing.task))
            self._keep(_Loser(drop, operation.service))
        return _Answer(
            attempt.reply.result(), attempt.server, now_s - began_s, queued_s=began_s - computing.asked_s
        )

    async def _call_onboard(self, call: _Call) -> Any:
        expected_s = self._selection.estimates.local_s(call.operation) or 0.0
        return call.method.decode(
            await self._onboard.call(
                call.operation.service,
                call.operation.method,
                call.request,
                timeout_s=max(_LOCAL_LEAST_S, _LOCAL_FACTOR * expected_s),
                once=call.method.once,
            )
        )

    # --- hedging --------------------------------------------------------------------------------------------

    def _plan_hedge(self, decision: Remote, operation: Operation) -> Hedge | None:
        """None where there is no hedging, no budget left for it, or a loser that still runs."""
        local_s = self._selection.estimates.local_s(operation)
        if self._hedging is None or local_s is None or any(not each.task.done() for each in self._losers):
            return None
        return self._hedging.plan(decision.server, operation, local_s=local_s, deadline_s=decision.deadline_s)

    async def _answer_hedged(self, decision: Remote, hedge: Hedge, call: _Call) -> _Answer:
        attempt = self._send_out(self._attempt(call, decision.server, hedge.deadline_s))
        remote = attempt.reply
        assert remote is not None  # noqa: S101 - it was just sent
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(hedge.after_s):
                    await asyncio.shield(remote)
        except BaseException:
            await end_all([remote])
            raise
        if remote.done():
            if (reply := remote.result()) is not None:
                return _Answer(reply, decision.server)
            return await self._answer_onboard(call, instead_of=attempt)
        self._journal.record("hedged", server=decision.server, **msgspec.to_builtins(hedge))
        answer = await self._race(call, self._begin_onboard(call), attempt)
        in_time = hedge.after_s + answer.onboard_s <= decision.deadline_s
        if self._hedging is not None and answer.place == decision.server and in_time:
            self._hedging.added(self._selection.estimates.local_s(call.operation) or 0.0)
        return replace(answer, hedged_s=hedge.after_s)

    async def _drop(self, operation: Operation, local: asyncio.Task[Any]) -> None:
        with contextlib.suppress(UpwashError):  # which is in the log
            await local
        self._journal.record("dropped", operation=str(operation), place=PLACE)

    def _keep(self, loser: _Loser) -> None:
        self._losers = [each for each in (*self._losers, loser) if not each.task.done()]

    async def _queue(self, service: str) -> float:
        """Waits until the drone's own service is done with calls that servers answered; returns for how long."""
        began_s = self._now_s()
        for loser in [each for each in self._losers if each.service == service and not each.task.done()]:
            await asyncio.shield(loser.task)
        return self._now_s() - began_s

    async def _stop_losers(self) -> None:
        await end_all([each.task for each in self._losers])

    # --- in the background ----------------------------------------------------------------------------------

    async def _look(self) -> None:
        while True:
            self.tell(Looked())
            self._look_now.clear()
            alarm = asyncio.get_running_loop().call_later(self._period_s, self._look_now.set)
            await self._look_now.wait()
            alarm.cancel()

    async def _watch_borders(self) -> None:
        """Looks at once where a border is crossed; while the vehicle is silent, once a period has to do."""
        areas = [server.area for server in self._selection.servers.values()]
        silent = False
        while True:
            try:
                await self._autopilot.border_crossed(areas)
            except AutopilotLost as error:
                if not silent:
                    self._journal.record("border_watch_failed", why=str(error))
                silent = True
                await asyncio.sleep(self._period_s)
            else:
                silent = False
                self.tell(Looked())

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()


def _lost(answer: _Answer) -> str:
    """Why a call that was sent to a server was answered on the drone."""
    if answer.remote_fault:
        return f"it raised there, which was {answer.remote_fault}"
    return "no usable answer, so" if answer.fell_back else "late, and sooner"


async def _first_over(remote: asyncio.Task[Any], local: asyncio.Task[Any]) -> asyncio.Task[Any] | None:
    """The one that answers first; None once the remote one has failed before that."""
    first: asyncio.Future[asyncio.Task[Any] | None] = asyncio.get_running_loop().create_future()

    def note(ended: asyncio.Task[Any]) -> None:
        if first.done():
            return
        if not _has_failed(ended):
            first.set_result(ended)
        elif remote.done():
            first.set_result(None)

    remote.add_done_callback(note)
    local.add_done_callback(note)
    return await first


def _has_failed(call: asyncio.Task[Any]) -> bool:
    """Whether the call is over without an answer."""
    return call.done() and (call.cancelled() or call.exception() is not None or call.result() is None)


def _is_answered(call: asyncio.Task[Any]) -> bool:
    return call.done() and not _has_failed(call)
