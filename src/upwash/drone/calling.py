"""One call: on a server, on the drone's own service, or on both, with the first answer.

    sent to a server alone    the drone's own service starts if the server fails
    hedged                    ... or is late (core/selection/hedging.py); the first answer counts
    with a deadline           a second server gets late calls too (core/selection/deadlines.py)
    raced                     both start at once, as the server is on trial
    on the drone              a server that becomes READY before the drone is done gets the call too
    with two answers          the drone computes the first, at once or where the server is late; a server's answer
                              by the deadline is better, whenever the server is READY (docs/two-answers.md)

The loser runs on, as a computation cannot be broken off, and its answer is dropped. The lane of its place is held
until then (core/selection/lanes.py): the next call waits for it, or goes elsewhere.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import defaultdict
from collections.abc import Coroutine
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

from msgspec import Struct, structs

from upwash.core.geo import Position
from upwash.core.operation import ON_DRONE, Operation
from upwash.core.policies.policy import NO_INPUTS, Decision, Inputs, Lightened, Remote
from upwash.core.selection import events
from upwash.core.selection.deadlines import Deadlines
from upwash.core.selection.hedging import Hedge, Hedging
from upwash.drone.before_sending import BeforeSending, NotReduced
from upwash.drone.decisions import Decisions, now_s
from upwash.drone.line import AT_ONCE, Turn
from upwash.drone.onboard import OnboardServices
from upwash.drone.pending import Hearing
from upwash.drone.radios import RadioWorker, RadioWorkers
from upwash.drone.server_session import ServerSession
from upwash.errors import UNREACHED, DeadlineExceeded, LinkError, NoLease, NotBegun, UpwashError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method, Reply
from upwash.support.background import begin, end, first

RemoteFault: TypeAlias = Literal["", "confirmed", "denied"]  # by the drone's own service
_LOCAL_LEAST_S = 30.0
_QUEUED_S = 1.0  # until a call that only servers compute goes where it was not begun
_MOMENT_S = 0.001  # before a deadline: a timer may run early
_LOCAL_FACTOR = 10.0  # times the estimate: a local call that takes longer hangs


class Invocation(Struct, frozen=True):
    """The mission's call, encoded; if `lightened` is set, `operation` and `request` are the lighter ones.

    `waypoint` is where it was made, if several calls may be open at the same time.
    """

    operation: Operation
    method: Method
    request: bytes
    waypoint: int | None = None
    lightened: Lightened | None = None

    def under(self, operation: Operation) -> Invocation:
        """The same call as another operation of its method."""
        return structs.replace(
            self, operation=operation, request=self.method.under(operation.key, self.request)
        )

    def lighter(self, lightened: Lightened | None) -> Invocation:
        """The same call as the lighter operation; unchanged for None."""
        if lightened is None:
            return self
        return structs.replace(self.under(lightened.operation), lightened=lightened)


@dataclass(slots=True)
class Twice:
    """A call with two answers: the drone's `first`, which the mission hears at once, and a server's by `by_s`."""

    first: Invocation
    by_s: float
    hearing: Hearing
    turn: Turn
    asked_s: float
    asked: Operation
    has_failed: asyncio.Event = field(default_factory=asyncio.Event)  # a server
    is_sent: bool = False  # its place in line is a server
    gives_up: bool = False  # the mission needs no better answer


@dataclass(slots=True, eq=False)
class Attempt:
    """A call to a server, READY since `check`, and the drone's own computation of it, if any."""

    call: Invocation
    server: str
    worker: RadioWorker
    session: ServerSession
    check: int
    deadline_s: float
    position: Position  # of the drone when it was made
    inputs: Inputs = NO_INPUTS  # of the decision
    sends_less: bool = False  # after a part that makes the request smaller
    reply: asyncio.Task[Any] | None = None  # where it is not simply waited for
    rival: asyncio.Task[Any] | None = None  # the drone's own service
    part_s: float = 0.0  # that the part before sending took
    sent_bytes: int = 0
    raised: str = ""  # the exception of the service that the server reports
    is_queued: bool = False  # it ended in the server's queue, before it began
    delay_s: float = 0.0  # until that report
    verdict: RemoteFault = ""  # on the report
    twice: Twice | None = None  # its answer is the better one
    of: Attempt | None = None  # an attempt at two servers, which has this part
    winner: Attempt | None = None  # of an attempt at two servers
    second_s: float | None = None  # from its begin until the second server got it
    answer: Any = None  # which is decoded

    def became(self, winner: Attempt) -> None:
        """Note which of its two servers has answered, or has the last word if none has."""
        self.winner = winner
        self.server, self.worker, self.session, self.check = (
            winner.server,
            winner.worker,
            winner.session,
            winner.check,
        )
        self.inputs, self.sends_less, self.part_s, self.sent_bytes = (
            winner.inputs,
            winner.sends_less,
            winner.part_s,
            winner.sent_bytes,
        )
        self.raised, self.delay_s, self.verdict = winner.raised, winner.delay_s, winner.verdict

    @property
    def facts_of_sending(self) -> dict[str, Any]:
        """What a part before sending made of the request, as a call's log record has it."""
        if not self.sends_less:
            return {}
        return {
            "whole_bytes": len(self.call.request),
            "sent_bytes": self.sent_bytes,
            "part_s": self.part_s,
        }

    @property
    def told_of_sending(self) -> str:
        """What was sent, and why, after a semicolon; "" where no part may run before sending."""
        inputs = self.inputs
        if inputs.whole_s is None or inputs.less_s is None:
            return ""
        if inputs.sends_less and not self.sends_less:
            return "; sent whole, as it was not made smaller"
        how = "made smaller before sending" if self.sends_less else "sent whole"
        return f"; {how}: {inputs.less_s:.2f} s expected with less to send, {inputs.whole_s:.2f} s whole"

    @property
    def late(self) -> bool:
        """Whether the mission had another answer before."""
        if self.twice is not None:
            return self.twice.gives_up or self.twice.hearing.first.done()
        if self.of is not None:
            return self.of.winner not in (None, self) or self.of.late
        return self.rival is not None and self.rival.done() and not _has_failed(self.rival)


class CallAnswer(Struct, frozen=True):
    """The answer of one call; the fields are those of the event `schema.Call`."""

    reply: Any
    call: Invocation
    attempt: Attempt | None = None  # that answered it; None where the drone did
    onboard_s: float = 0.0
    fell_back: bool = False
    hedged_s: float | None = None
    queued_s: float = 0.0
    remote_fault: RemoteFault = ""
    overtook: bool = False  # a server that became of use while the drone was at it
    first_s: float | None = (
        None  # from the call to the first answer, if the mission heard two or waited for two
    )

    @property
    def server(self) -> str | None:
        """The server that answered; None if the drone did."""
        return self.attempt.server if self.attempt is not None else None


@dataclass(slots=True)
class _Computing:
    """The drone's own computation of a call, which begins when earlier calls of the service are done."""

    call: Invocation
    asked_s: float
    began_s: float | None = None
    task: asyncio.Task[Any] = field(init=False)


class Calling:
    """Answers calls, each once, and reports their results to the core."""

    def __init__(
        self,
        decisions: Decisions,
        radios: RadioWorkers,
        onboard: OnboardServices,
        journal: Journal,
        hedging: Hedging,
        *,
        deadlines: Deadlines | None = None,
        before_sending: BeforeSending | None = None,
    ) -> None:
        self._decisions = decisions
        self._before_sending = before_sending or BeforeSending({}, journal)
        self._estimates = decisions.selection.estimates
        self._radios = radios
        self._onboard = onboard
        self._journal = journal
        self._hedging = hedging
        self._deadlines = deadlines or Deadlines()
        # The rest of answered calls, each with the drone's own service that is busy with it, if any.
        self._losers: dict[asyncio.Task[Any], str | None] = {}
        self._turns = defaultdict[str, asyncio.Lock](asyncio.Lock)  # of the calls of each of its services

    async def answer(self, decision: Decision, call: Invocation, turn: Turn = AT_ONCE) -> CallAnswer:
        """The answer to a call that runs where the decision says, or on the drone if the server fails.

        A call that the server does not begin takes its turn on the drone.
        """
        self._hedging.called(call.operation)
        self._deadlines.called(call.operation)
        if not isinstance(decision, Remote):
            return await self._race(self._begin_onboard(call), None)
        if decision.raced:
            attempt = self._begin_at_server(call, decision)
            return await self._race(self._begin_onboard(call), attempt)
        is_busy = any(not loser.done() for loser in self._losers) or not self._is_free(ON_DRONE)
        within_s = self._deadlines.within_s(call.operation)
        hedge = self._hedging.plan(decision, call.operation, is_busy=is_busy, within_s=within_s)
        if hedge is not None:
            return await self._answer_hedged(decision, hedge, call)
        attempt = self.attempt(call, decision)
        reply = await self.at_servers(attempt)
        if reply is None and attempt.is_queued:
            began_s = now_s()
            async with turn.on_drone_instead():
                queued_s = now_s() - began_s
                answer = await self._fall_back(call, attempt)
                return structs.replace(answer, queued_s=answer.queued_s + queued_s)
        return await self._fall_back(call, attempt) if reply is None else CallAnswer(reply, call, attempt)

    async def by_server(self, decision: Remote, call: Invocation, *, raised_before: bool) -> CallAnswer | str:
        """The answer to a call that only servers compute; else the exception that the server reports, "" for none.

        A server's first report counts against the server, a second one, after `raised_before`, against the call.
        """
        attempt = self.attempt(call, decision)
        if (reply := await self.at_server(attempt)) is not None:
            return CallAnswer(reply, call, attempt)
        if attempt.is_queued:
            await asyncio.sleep(_QUEUED_S)
        if not attempt.raised:
            return ""
        why = f"{attempt.server} says that {call.operation} raised {attempt.raised}"
        if attempt.sends_less:  # which may be the fault of what was sent
            self._decisions.part_failed(call.operation, why)
            longer = (attempt.inputs.whole_s or 1.0) / (attempt.inputs.less_s or 1.0)
            whole = replace(decision, deadline_s=longer * decision.deadline_s, inputs=NO_INPUTS)
            if not self._decisions.may_send(attempt.server, attempt.check):
                return ""
            return await self.by_server(whole, call, raised_before=raised_before)
        self._decisions.tell(
            events.RemoteFaultTested(
                attempt.server, attempt.check, call.operation, attempt.delay_s, why, raised_before
            )
        )
        return why

    async def queue(self, service: str) -> float:
        """Waits until the drone's service is done with calls that servers answered; returns the seconds waited."""
        began_s = now_s()
        for loser in [loser for loser, busy in self._losers.items() if busy == service and not loser.done()]:
            await asyncio.shield(loser)
        return now_s() - began_s

    async def stop_losers(self) -> None:
        """Ends the computations that go on after their calls were answered."""
        await end(*self._losers)

    # --- one place ------------------------------------------------------------------------------------------

    async def at_servers(self, attempt: Attempt) -> Any | None:
        """The decoded reply of the server, or of the second server of a call with a deadline; None if none answers.

        The exception that a server reports ends both tries, as the drone tests it.
        """
        operation, began_s = attempt.call.operation, now_s()
        if self._deadlines.within_s(operation) is None:
            return await self.at_server(attempt)
        second = self._decisions.second(operation, beside=attempt.server)
        plan = self._deadlines.prospect(operation, attempt.server, second)
        if plan is None or plan.after_s is None:
            return await self.at_server(attempt)
        tries = [replace(attempt, of=attempt)]
        replies = [self._sent(tries[0])]
        try:
            await asyncio.wait(replies, timeout=plan.after_s)
            if not _settles(tries[0], replies[0]) and (other := self._ask_second(attempt, began_s)):
                tries.append(other)
                replies.append(self._sent(other))
            while not any(map(_settles, tries, replies)) and (
                left := [one for one in replies if not one.done()]
            ):
                await asyncio.wait(left, return_when=asyncio.FIRST_COMPLETED)
        except BaseException:
            await end(*replies)
            raise
        for one, reply in zip(tries, replies, strict=True):
            if _settles(one, reply):
                attempt.became(one)
                for loser in replies:
                    if not loser.done():
                        self._keep(loser, None)
                return reply.result()
        return None

    def _ask_second(self, attempt: Attempt, began_s: float) -> Attempt | None:
        """The same call at another READY server, in the time that is left; None if no server may get it."""
        call, after_s = attempt.call, now_s() - began_s
        left_s = attempt.deadline_s - after_s
        if attempt.late or left_s <= 0 or not self._deadlines.may_ask(call.operation):
            return None
        server = self._decisions.second(call.operation, beside=attempt.server, begins=True)
        if server is None:
            return None
        self._deadlines.asked(call.operation)
        attempt.second_s = after_s
        other = self.attempt(call, Remote(server, left_s, f"{attempt.server} is late"))
        other.of = attempt
        self._journal.record(
            schema.Seconded(
                waypoint=call.waypoint,
                operation=str(call.operation),
                server=attempt.server,
                second=server,
                check=other.check,
                after_s=after_s,
                deadline_s=left_s,
            )
        )
        return other

    async def at_server(self, attempt: Attempt) -> Any | None:
        """The server's decoded reply if it carries a value; None after any failure, which is reported to the core."""
        call, server, began_s = attempt.call, attempt.server, now_s()
        operation, method = call.operation, call.method
        request, deadline_s = call.request, attempt.deadline_s
        if attempt.sends_less:
            request = await self._made_smaller(attempt)
            deadline_s -= now_s() - began_s
            if not self._may_send(attempt, deadline_s):
                return None
            if not attempt.sends_less:
                began_s = now_s()
        try:
            answer = await attempt.session.call(
                operation.service,
                operation.method,
                request,
                deadline_s=deadline_s,
                may_queue_s=self._decisions.may_queue_s(server, operation, deadline_s),
            )
            reply = method.decode(answer)
        except NotBegun as told:
            waited_s = now_s() - began_s
            attempt.is_queued = True
            self._journal.record(
                schema.RemoteQueued(
                    waypoint=call.waypoint,
                    server=server,
                    check=attempt.check,
                    waited_s=waited_s,
                    queue_s=told.queue_s,
                    why=str(told),
                )
            )
            self._decisions.tell(
                events.RemoteCallQueued(server, str(told), waited_s, told.queue_s, attempt.late)
            )
            return None
        except NoLease as error:
            self._decisions.tell(events.SlotTaken(attempt.check, str(error), in_call=True))
            return None
        except LinkError as error:
            self._journal.record(schema.RemoteFailed(server=server, check=attempt.check, why=str(error)))
            if isinstance(error, DeadlineExceeded):
                waited_s, less = now_s() - began_s, attempt.sends_less
                attempt.worker.cut = events.RemoteCallCut(server, operation, waited_s, less)
            self._decisions.tell(events.RemoteCallFailed(server, attempt.check, str(error), attempt.late))
            self._deadlines.answered(server, operation, math.inf)
            if isinstance(error, UNREACHED):
                self._reached(attempt, now_s() - began_s, None)
            return None
        delay_s = now_s() - began_s
        if raised := method.raised(reply):
            attempt.raised, attempt.delay_s = raised, delay_s
            self._doubt(attempt)
            self._reached(attempt, delay_s, len(answer))
            return None
        if attempt.late and (attempt.twice is None or attempt.twice.gives_up):
            self._journal.record(schema.Dropped(operation=str(operation), place=server))
        less = attempt.sends_less
        self._deadlines.answered(server, operation, delay_s)
        self._hedging.answered(server, operation, delay_s, less=less)
        queued_s, queue_s = (answer.queued_s, answer.queue_s) if isinstance(answer, Reply) else (0.0, 0.0)
        self._decisions.tell(
            events.RemoteCallEnded(
                server, operation, delay_s, attempt.late, less, min(queued_s, delay_s), queue_s
            )
        )
        self._reached(attempt, delay_s, len(answer))
        return reply

    async def _made_smaller(self, attempt: Attempt) -> bytes:
        """The request that is sent; the whole one, and `sends_less` no more, if the part before sending fails."""
        call, began_s = attempt.call, now_s()
        request, operation = call.request, call.operation
        try:
            request = await self._before_sending.reduce(
                operation.service, call.method, request, deadline_s=attempt.deadline_s
            )
        except NotReduced as error:
            self._decisions.part_failed(operation, str(error))
        attempt.sends_less = request is not call.request
        attempt.part_s, attempt.sent_bytes = now_s() - began_s, len(request)
        return request

    def _may_send(self, attempt: Attempt, left_s: float) -> bool:
        """Whether the server is still of use, and may answer a call sent whole after all in the time left."""
        expected_s = self._estimates.remote_s(attempt.server, attempt.call.operation) or 0.0
        if not attempt.sends_less and expected_s > left_s:
            return False
        return self._decisions.may_send(attempt.server, attempt.check)

    async def onboard(self, call: Invocation) -> Any:
        """The decoded reply of the drone's own service; raises InstanceError if the service fails."""
        expected_s = self._estimates.local_s(call.operation) or 0.0
        return call.method.decode(
            await self._onboard.call(
                call.operation.service,
                call.operation.method,
                call.request,
                timeout_s=max(_LOCAL_LEAST_S, _LOCAL_FACTOR * expected_s),
                once=call.method.once,
            )
        )

    def attempt(self, call: Invocation, decision: Remote) -> Attempt:
        """An attempt at the server, which is READY; it is not begun."""
        server = decision.server
        worker = self._radios.worker_at(server)
        assert worker.session is not None  # noqa: S101 - a server is READY only by its session
        check = self._decisions.selection.servers[server].check
        position = self._decisions.position
        inputs, deadline_s = decision.inputs, decision.deadline_s
        return Attempt(
            call, server, worker, worker.session, check, deadline_s, position, inputs, inputs.sends_less
        )

    def _reached(self, attempt: Attempt, delay_s: float, answer_bytes: int | None) -> None:
        """Report to the core how fast the server answered at this place, for a server without a range."""
        call, server = attempt.call, attempt.server
        if self._estimates.is_measured(server):
            sent_bytes, less = attempt.sent_bytes or len(call.request), attempt.sends_less
            answered, size_bytes = answer_bytes is not None, sent_bytes + (answer_bytes or 0)
            self._decisions.tell(
                events.Reached(server, attempt.position, answered, call.operation, delay_s, size_bytes, less)
            )

    def _doubt(self, attempt: Attempt) -> None:
        """Log the reported exception; the mission only gets exceptions of the drone's own service."""
        server, operation, raised = attempt.server, str(attempt.call.operation), attempt.raised
        why = f"{server} says that {operation} raised {raised}"
        if attempt.call.method.patience is not None:  # the drone cannot test it
            self._journal.record(schema.RemoteFailed(server=server, check=attempt.check, why=why))
            return
        self._journal.record(
            schema.RemoteRaised(server=server, check=attempt.check, operation=operation, raised=raised)
        )
        if attempt.twice is not None:  # the drone computes another operation, which tests nothing
            if attempt.sends_less:  # which may be the fault of what was sent
                self._decisions.part_failed(attempt.call.operation, why)
            else:
                self._decisions.tell(events.RemoteCallFailed(server, attempt.check, why, attempt.late))
        elif (
            attempt.late and attempt.of is not None and attempt.of.winner is not None
        ):  # another server answered
            self._decisions.tell(events.RemoteCallFailed(server, attempt.check, why, late=True))
        elif attempt.late and (rival := (attempt.of or attempt).rival) is not None:
            self.test(attempt, rival.result())
        else:
            self._decisions.tell(events.RemoteCallRaised(server, why))

    def test(self, attempt: Attempt, onboard: Any) -> None:
        """Compare the exception that the server reported, if any, with the drone's own result of the same call."""
        if not attempt.raised or attempt.verdict:
            return
        server, operation, check = attempt.server, attempt.call.operation, attempt.check
        less = attempt.sends_less
        confirmed = bool(attempt.call.method.raised(onboard))
        attempt.verdict = "confirmed" if confirmed else "denied"
        why = f"it says that {operation} raised {attempt.raised}, which did not raise on the drone"
        if confirmed:
            self._hedging.answered(server, operation, attempt.delay_s, less=less)
        elif less:  # which may be the fault of what was sent
            self._decisions.part_failed(operation, f"{server} says that it raised {attempt.raised} then")
            return
        else:
            attempt.session.deny(operation.service)
            self._journal.record(schema.RemoteFailed(server=server, check=check, why=f"{server}: {why}"))
        self._decisions.tell(
            events.RemoteFaultTested(server, check, operation, attempt.delay_s, why, confirmed, less)
        )

    # --- both places ----------------------------------------------------------------------------------------

    async def _answer_hedged(self, decision: Remote, hedge: Hedge, call: Invocation) -> CallAnswer:
        attempt = self._begin_at_server(call, replace(decision, deadline_s=hedge.deadline_s))
        remote = attempt.reply
        assert remote is not None  # noqa: S101 - it was just begun
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(hedge.after_s):
                    await asyncio.shield(remote)
        except BaseException:
            await end(remote)
            raise
        while not remote.done() and not self._is_free(ON_DRONE):  # with an earlier call
            await self._decisions.until_told(remote, until_s=math.inf)
        if remote.done():
            if (reply := remote.result()) is not None:
                return CallAnswer(reply, call, attempt)
            return await self._fall_back(call, attempt)
        self._journal.record(
            schema.Hedged(
                waypoint=call.waypoint,
                server=decision.server,
                check=attempt.check,
                after_s=hedge.after_s,
                deadline_s=hedge.deadline_s,
            )
        )
        answer = await self._race(self._begin_onboard(call), attempt)
        if answer.server == decision.server:
            self._hedging.overtaken(hedge, decision, call.operation, onboard_s=answer.onboard_s)
        return structs.replace(answer, hedged_s=hedge.after_s)

    async def answer_twice(self, decision: Decision, call: Invocation, twice: Twice) -> CallAnswer:
        """The server's answer by the deadline, else the drone's; the mission hears the drone's at once."""
        self._hedging.called(call.operation)
        twice.is_sent = isinstance(decision, Remote) and not decision.raced
        better = begin(self._better(decision, call, twice))
        computing = answer = None
        try:
            if isinstance(decision, Remote) and not decision.raced:  # it is expected before the first one
                await self._until_late(decision, better, twice)
            if not (better.done() and better.result()):
                computing = self._begin_onboard(twice.first)
                if not await _is_sooner(better, computing.task):
                    answer = await self._first_answer(computing, twice)
                    await first(asyncio.wait((better,)), twice.hearing.enough.wait())
        except BaseException:
            await end(better, computing.task if computing is not None else None)
            raise
        if not better.done():
            twice.gives_up = True
            self._keep(better, None)
        elif (attempt := better.result()) is not None:
            if computing is not None and not computing.task.done():
                return structs.replace(self._won(attempt, computing), call=call)
            if answer is None:
                return CallAnswer(attempt.answer, call, attempt)
            return CallAnswer(attempt.answer, call, attempt, answer.onboard_s, first_s=answer.first_s)
        if answer is None:
            assert computing is not None  # noqa: S101 - without a better answer the drone has computed
            await computing.task  # which raises why it has none
            raise AssertionError("the first answer is there after all")
        return structs.replace(answer, fell_back=twice.has_failed.is_set())

    async def _until_late(self, decision: Remote, better: asyncio.Task[Any], twice: Twice) -> None:
        """Return when the server has answered, has failed or is late."""
        hedge = self._hedging.plan(decision, twice.first.operation, is_busy=False)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(hedge.after_s if hedge else decision.deadline_s):
                await first(asyncio.wait((better,)), twice.has_failed.wait())

    async def _first_answer(self, computing: _Computing, twice: Twice) -> CallAnswer | None:
        """The drone's answer; None if its service fails, as a better one may still come."""
        try:
            reply = await asyncio.shield(computing.task)
        except UpwashError:
            return None
        finally:
            if not twice.is_sent:
                twice.turn.leave()
        answer = self._done_onboard(reply, computing, None, asked=twice.asked)
        first_s = now_s() - twice.asked_s
        if not twice.first.method.raised(reply):
            twice.hearing.hear(reply, twice.first.operation, first_s)
        return structs.replace(answer, first_s=first_s)

    async def _better(self, decision: Decision, call: Invocation, twice: Twice) -> Attempt | None:
        """The attempt at a server that has answered the call by the deadline; None if there is none."""
        sent: Decision | None = decision
        while True:
            left_s = twice.by_s - now_s()
            if (
                isinstance(sent, Remote)
                and left_s > _MOMENT_S
                and (twice.is_sent or twice.turn.is_next(sent.server, twice.by_s))
            ):
                deadline_s = min(sent.deadline_s, left_s)
                attempt = self.attempt(call, replace(sent, deadline_s=deadline_s))
                attempt.twice = twice
                is_sent, twice.is_sent = twice.is_sent, False
                twice.turn.sends()
                attempt.reply = self._sent(attempt)
                try:
                    reply = await asyncio.shield(attempt.reply)
                except BaseException:
                    await end(attempt.reply)
                    raise
                finally:
                    if is_sent:
                        twice.turn.leave()
                if reply is not None:
                    attempt.answer = reply
                    return attempt
                twice.has_failed.set()
                if attempt.raised:
                    return None
            sent = await self._server_by(call, twice)
            if sent is None:
                return None

    async def _server_by(self, call: Invocation, twice: Twice) -> Remote | None:
        """The next server that can answer by the deadline; None without one, at once if the mission waits."""
        hearing, selection = twice.hearing, self._decisions.selection
        while twice.by_s - now_s() > _MOMENT_S and not hearing.enough.is_set():
            in_use = selection.current
            is_next = in_use is not None and twice.turn.is_next(in_use.name, twice.by_s)
            sent, may_come = self._decisions.better(
                call.operation, by_s=twice.by_s, is_next=is_next, waypoint=call.waypoint
            )
            if sent is not None:
                return sent
            if hearing.waits.is_set() and not may_come:
                return None
            changes: list[Coroutine[Any, Any, object]] = [self._decisions.told()]
            if not hearing.waits.is_set():
                changes.append(hearing.waits.wait())
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(twice.by_s - now_s()):
                    await first(*changes)
        return None

    async def _fall_back(self, call: Invocation, attempt: Attempt) -> CallAnswer:
        """Compute on the drone: after a reported exception the same call, to test it; else perhaps a lighter one."""
        if not attempt.raised and call.lightened is None:
            call = call.lighter(self._decisions.fall_back(call.operation))
        return await self._race(self._begin_onboard(call), attempt)

    async def _race(self, computing: _Computing, attempt: Attempt | None) -> CallAnswer:
        """The first answer, of the drone's own service or of a server.

        `attempt` is the last attempt at a server; it is under way if it has a `reply`.
        """
        overtaking = False
        try:
            while True:
                if attempt is not None and attempt.reply is not None:
                    attempt.rival = computing.task
                    if await _first_over(attempt.reply, computing.task) is attempt.reply:
                        return structs.replace(self._won(attempt, computing), overtook=overtaking)
                if attempt is not None and attempt.raised:
                    break
                decision = await self._overtaken(computing)
                if decision is None:
                    break
                attempt, overtaking = self._begin_at_server(computing.call, decision), True
            reply = await asyncio.shield(computing.task)
        except BaseException:
            await end(computing.task, attempt.reply if attempt is not None else None)
            raise
        return self._done_onboard(reply, computing, attempt)

    def _begin_at_server(self, call: Invocation, decision: Remote) -> Attempt:
        attempt = self.attempt(call, decision)
        attempt.reply = begin(self.at_servers(attempt))
        self._hold(attempt.reply, attempt)
        return attempt

    def _sent(self, attempt: Attempt) -> asyncio.Task[Any | None]:
        reply = begin(self.at_server(attempt))
        self._hold(reply, attempt)
        return reply

    def _hold(self, reply: asyncio.Task[Any], attempt: Attempt) -> None:
        """Hold the lane of the server until the reply is there."""
        expected_s = self._estimates.remote_s(attempt.server, attempt.call.operation) or 0.0
        queue_s = self._decisions.selection.lanes.queue_s(attempt.server, now_s())
        self._decisions.hold(reply, attempt.server, queue_s + expected_s)

    def _is_free(self, place: str) -> bool:
        return self._decisions.selection.lanes.is_free(place)

    def _begin_onboard(self, call: Invocation) -> _Computing:
        computing = _Computing(call, now_s())

        async def compute() -> Any:
            await self.queue(call.operation.service)
            async with self._turns[call.operation.service]:
                computing.began_s = now_s()
                return await self.onboard(call)

        computing.task = begin(compute())
        self._decisions.hold(computing.task, ON_DRONE, self._estimates.local_s(call.operation))
        return computing

    async def _overtaken(self, computing: _Computing) -> Remote | None:
        """The decision for a server that would answer before the drone; None if the drone is done first."""
        if not self._decisions.selection.overtakes:
            return None
        while not computing.task.done():
            began_s = now_s() if computing.began_s is None else computing.began_s
            call = computing.call
            decision, again_s = self._decisions.overtake(
                call.operation, began_s=began_s, waypoint=call.waypoint
            )
            if decision is not None:
                return decision
            await self._decisions.until_told(computing.task, until_s=again_s)
        return None

    def _done_onboard(
        self, reply: Any, computing: _Computing, attempt: Attempt | None, *, asked: Operation | None = None
    ) -> CallAnswer:
        began_s = computing.asked_s if computing.began_s is None else computing.began_s
        delay_s = now_s() - began_s
        late = attempt.reply if attempt is not None else None
        if late is not None and late.done():
            late = None
        if attempt is not None:
            self.test(attempt, reply)
        if late is not None:
            self._keep(late, None)
        self._decisions.tell(events.LocalCallEnded(computing.call.operation, delay_s, asked))
        return CallAnswer(
            reply,
            computing.call,
            onboard_s=delay_s,
            fell_back=attempt is not None and late is None,
            queued_s=began_s - computing.asked_s,
            remote_fault=attempt.verdict if attempt is not None else "",
        )

    def _won(self, attempt: Attempt, computing: _Computing) -> CallAnswer:
        assert attempt.reply is not None  # noqa: S101 - it has answered
        ended_s, call = now_s(), computing.call
        began_s = ended_s if computing.began_s is None else computing.began_s
        if computing.began_s is None:
            computing.task.cancel()  # it was still in line
        else:
            self._keep(begin(self._drop(call.operation, computing.task)), call.operation.service)
        reply, queued_s = attempt.reply.result(), began_s - computing.asked_s
        return CallAnswer(reply, call, attempt, ended_s - began_s, queued_s=queued_s)

    async def _drop(self, operation: Operation, local: asyncio.Task[Any]) -> None:
        with contextlib.suppress(UpwashError):  # which is in the log
            await local
        self._journal.record(schema.Dropped(operation=str(operation), place=ON_DRONE))
        self._decisions.wake()  # the drone's service is free

    def _keep(self, loser: asyncio.Task[Any], busy: str | None) -> None:
        """Keep the rest of an answered call, and forget those that are over."""
        for earlier in self._losers:
            if earlier.done() and not earlier.cancelled():
                earlier.result()  # which raises a defect, and so ends offloading
        kept = (self._losers | {loser: busy}).items()
        self._losers = {task: service for task, service in kept if not task.done()}


def _settles(attempt: Attempt, reply: asyncio.Task[Any]) -> bool:
    """Whether the server has answered, with an exception perhaps."""
    return reply.done() and (reply.result() is not None or bool(attempt.raised))


def _has_failed(call: asyncio.Task[Any]) -> bool:
    """Whether the call is over without an answer."""
    return call.done() and (call.cancelled() or call.exception() is not None or call.result() is None)


async def _is_sooner(better: asyncio.Task[Any], local: asyncio.Task[Any]) -> bool:
    """Whether the better answer is there before the drone's; returns when one of them is."""
    await asyncio.wait((better, local), return_when=asyncio.FIRST_COMPLETED)
    if better.done() and better.result() is None:
        await asyncio.wait((local,))
    return better.done() and better.result() is not None


async def _first_over(remote: asyncio.Task[Any], local: asyncio.Task[Any]) -> asyncio.Task[Any] | None:
    """The task that answers first; None if the remote task fails before that."""
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
