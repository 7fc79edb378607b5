"""How a call comes to its one answer, where the drone's own service and a server may both be at it.

    sent to a server alone    the drone's own service starts when that has failed
    hedged                    ... or when the server is late (core/selection/hedging.py); the first answer counts
    raced                     both start at once, as the server is on trial
    on the drone              a server that becomes of use before the drone is done gets the call too

The loser runs on, as a computation cannot be broken off, and its answer is dropped. The drone's own service is busy
until then: the next call of that service waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, field, replace
from typing import Any

from upwash.core.operation import Operation
from upwash.core.policies.policy import Decision, Remote
from upwash.core.selection.events import LocalCallEnded
from upwash.core.selection.hedging import Hedge, Hedging
from upwash.core.selection.places import ON_DRONE
from upwash.drone.calling import Attempt, Call, Calling, RemoteFault, has_failed
from upwash.drone.decisions import Decisions, now_s
from upwash.errors import UpwashError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.support.background import begin, end


@dataclass(frozen=True, slots=True)
class Answer:
    """What one call came to; the fields are those of the event `schema.Call`."""

    reply: Any
    call: Call
    attempt: Attempt | None = None  # that answered it; None where the drone did
    onboard_s: float = 0.0
    fell_back: bool = False
    hedged_s: float | None = None
    queued_s: float = 0.0
    remote_fault: RemoteFault = ""
    overtook: bool = False  # a server that became of use while the drone was at it

    @property
    def server(self) -> str | None:
        """The server that answered it; None where the drone did."""
        return self.attempt.server if self.attempt is not None else None


@dataclass(slots=True)
class _Computing:
    """The drone's own service at a call: first it may have to be done with an earlier one."""

    call: Call
    asked_s: float
    began_s: float | None = None
    task: asyncio.Task[Any] = field(init=False)


@dataclass(frozen=True, slots=True)
class _Loser:
    """What still runs of a call that is answered; `service` is the drone's own that is busy with it, if one is."""

    task: asyncio.Task[Any]
    service: str | None = None


class Racing:
    """Answers calls, each once."""

    def __init__(
        self, decisions: Decisions, calling: Calling, journal: Journal, hedging: Hedging | None
    ) -> None:
        self._decisions = decisions
        self._calling = calling
        self._journal = journal
        self._hedging = hedging
        self._losers: list[_Loser] = []

    async def answer(self, decision: Decision, call: Call) -> Answer:
        """The answer to a call that runs where the decision says, or on the drone when that fails."""
        local_s = self._decisions.estimates.local_s(call.operation)
        if self._hedging is not None and local_s is not None:
            self._hedging.count(local_s)
        if not isinstance(decision, Remote):
            return await self._answer_onboard(call)
        if decision.raced:
            return await self._answer_onboard(call, instead_of=self._begin_at_server(call, decision))
        if (hedge := self._plan_hedge(decision, call.operation)) is not None:
            return await self._answer_hedged(decision, hedge, call)
        attempt = self._calling.attempt(call, decision.server, decision.deadline_s)
        reply = await self._calling.at_server(attempt)
        if reply is not None:
            return Answer(reply, call, attempt)
        return await self._fall_back(call, attempt)

    async def queue(self, service: str) -> float:
        """Waits until the drone's own service is done with calls that servers answered; returns for how long."""
        began_s = now_s()
        for loser in [each for each in self._losers if each.service == service and not each.task.done()]:
            await asyncio.shield(loser.task)
        return now_s() - began_s

    async def stop_losers(self) -> None:
        """Ends what still runs of calls that are answered."""
        await end(*(each.task for each in self._losers))

    # --- hedging --------------------------------------------------------------------------------------------

    def _plan_hedge(self, decision: Remote, operation: Operation) -> Hedge | None:
        """None where there is no hedging, no budget left for it, or a loser that still runs."""
        local_s = self._decisions.estimates.local_s(operation)
        if self._hedging is None or local_s is None or any(not each.task.done() for each in self._losers):
            return None
        return self._hedging.plan(decision.server, operation, local_s=local_s, deadline_s=decision.deadline_s)

    async def _answer_hedged(self, decision: Remote, hedge: Hedge, call: Call) -> Answer:
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
        if remote.done():
            if (reply := remote.result()) is not None:
                return Answer(reply, call, attempt)
            return await self._fall_back(call, attempt)
        self._journal.record(
            schema.Hedged(
                server=decision.server,
                check=attempt.check,
                after_s=hedge.after_s,
                deadline_s=hedge.deadline_s,
            )
        )
        answer = await self._race(call, self._begin_onboard(call), attempt)
        in_time = hedge.after_s + answer.onboard_s <= decision.deadline_s
        if self._hedging is not None and answer.server == decision.server and in_time:
            self._hedging.added(self._decisions.estimates.local_s(call.operation) or 0.0)
        return replace(answer, hedged_s=hedge.after_s)

    # --- the race -------------------------------------------------------------------------------------------

    async def _fall_back(self, call: Call, attempt: Attempt) -> Answer:
        """Has the drone compute a call that the server has not answered.

        What the server says that the service raised is tested by the same call, which is not made lighter.
        """
        if attempt.said is None and call.lightened is None:
            call = call.lighter(self._decisions.fall_back(call.operation))
        return await self._answer_onboard(call, instead_of=attempt)

    async def _answer_onboard(self, call: Call, *, instead_of: Attempt | None = None) -> Answer:
        """Has the drone compute the call, and each server that is of use before the drone is done."""
        return await self._race(call, self._begin_onboard(call), instead_of)

    async def _race(self, call: Call, computing: _Computing, attempt: Attempt | None) -> Answer:
        """The first answer of the drone's own service and of servers.

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
                decision = await self._overtaken(computing)
                if decision is None:
                    break
                attempt, overtaking = self._begin_at_server(call, decision), True
            reply = await asyncio.shield(computing.task)
        except BaseException:
            under_way = [attempt.reply] if attempt is not None and attempt.reply is not None else []
            await end(computing.task, *under_way)
            raise
        return self._done_onboard(reply, computing, attempt)

    def _begin_at_server(self, call: Call, decision: Remote) -> Attempt:
        attempt = self._calling.attempt(call, decision.server, decision.deadline_s)
        attempt.reply = begin(self._calling.at_server(attempt))
        return attempt

    def _begin_onboard(self, call: Call) -> _Computing:
        computing = _Computing(call, now_s())

        async def compute() -> Any:
            await self.queue(call.operation.service)
            computing.began_s = now_s()
            return await self._calling.onboard(call)

        computing.task = begin(compute())
        return computing

    async def _overtaken(self, computing: _Computing) -> Remote | None:
        """Which server is to be at the call too, as soon as one is of use; None where the drone is done before."""
        if not self._decisions.overtakes:
            return None
        while not computing.task.done():
            began_s = now_s() if computing.began_s is None else computing.began_s
            decision, again_s = self._decisions.overtake(computing.call.operation, began_s=began_s)
            if decision is not None:
                return decision
            await self._decisions.until_told(computing.task, until_s=again_s)
        return None

    def _done_onboard(self, reply: Any, computing: _Computing, attempt: Attempt | None) -> Answer:
        """The drone's own answer, which was first; `attempt` is the last one at a server, if any was made."""
        began_s = computing.asked_s if computing.began_s is None else computing.began_s
        delay_s = now_s() - began_s
        late = attempt is not None and attempt.reply is not None and not attempt.reply.done()
        if attempt is not None:
            self._calling.test(attempt, reply)
            if late and attempt.reply is not None:
                self._keep(_Loser(attempt.reply))
        self._decisions.tell(LocalCallEnded(computing.call.operation, delay_s))
        return Answer(
            reply,
            computing.call,
            onboard_s=delay_s,
            fell_back=attempt is not None and not late,
            queued_s=began_s - computing.asked_s,
            remote_fault=attempt.verdict if attempt is not None else "",
        )

    def _won(self, attempt: Attempt, computing: _Computing) -> Answer:
        """The server's answer, which was first."""
        assert attempt.reply is not None  # noqa: S101 - it has answered
        ended_s, call = now_s(), computing.call
        began_s = ended_s if computing.began_s is None else computing.began_s
        if computing.began_s is None:
            computing.task.cancel()  # it was still in line
        else:
            drop = begin(self._drop(call.operation, computing.task))
            self._keep(_Loser(drop, call.operation.service))
        return Answer(
            attempt.reply.result(), call, attempt, ended_s - began_s, queued_s=began_s - computing.asked_s
        )

    async def _drop(self, operation: Operation, local: asyncio.Task[Any]) -> None:
        with contextlib.suppress(UpwashError):  # which is in the log
            await local
        self._journal.record(schema.Dropped(operation=str(operation), place=ON_DRONE))

    def _keep(self, loser: _Loser) -> None:
        for each in self._losers:
            if each.task.done() and not each.task.cancelled():
                each.task.result()  # which raises a defect, and so ends offloading
        self._losers = [each for each in (*self._losers, loser) if not each.task.done()]


async def _first_over(remote: asyncio.Task[Any], local: asyncio.Task[Any]) -> asyncio.Task[Any] | None:
    """The one that answers first; None once the remote one has failed before that."""
    first: asyncio.Future[asyncio.Task[Any] | None] = asyncio.get_running_loop().create_future()

    def note(ended: asyncio.Task[Any]) -> None:
        if first.done():
            return
        if not has_failed(ended):
            first.set_result(ended)
        elif remote.done():
            first.set_result(None)

    remote.add_done_callback(note)
    local.add_done_callback(note)
    return await first
