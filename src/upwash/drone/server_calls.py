"""Calls that only servers compute: each waits in the line for a server, and ends once.

    answered      by a server that is ready in range; after a failure there it is in line again, at its old place
    unanswered    at its deadline, at the bound of memory, when a service raised twice, or when the flight is over

A reported exception blames the server at first. A second report, of any server, blames the call, which ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Mapping
from typing import Any

from upwash.core.operation import Operation
from upwash.core.policies.policy import Remote
from upwash.core.selection.events import CallOver, CallWaits, SelectionEvent
from upwash.drone.calling import Calling, Invocation
from upwash.drone.decisions import Decisions, now_s
from upwash.drone.line import CallLine
from upwash.drone.pending import Hearing
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import NoAnswer
from upwash.support.background import begin, end, first

_LEAST_S = 10.0  # that a server in range gets for an answer that the mission waits for
_FACTOR = 3.0  # times the expected delay, likewise


class _Waiter:
    """A call that waits, until its limit of time ends it."""

    def __init__(self, asked: Invocation, limit: asyncio.Timeout) -> None:
        self.operation = asked.operation
        self.size_bytes = len(asked.request)
        self.has_deadline = limit.when() is not None
        self.why = ""  # it ended without an answer
        self._limit = limit

    def end(self, why: str, *, in_s: float = 0.0) -> None:
        """End the call without an answer after that time, unless it ends before."""
        until_s, before_s = now_s() + in_s, self._limit.when()
        if not self._limit.expired() and (before_s is None or until_s < before_s):
            self.why = why
            self._limit.reschedule(until_s)


class ServerCalls:
    """Makes the calls that only servers compute; `most_bytes` bounds the waiting requests of each service.

    `reach_s` returns the seconds until a server in range answers an operation, None where none can.
    """

    def __init__(
        self,
        decisions: Decisions,
        calling: Calling,
        line: CallLine,
        journal: Journal,
        *,
        tell: Callable[[SelectionEvent], None],
        reach_s: Callable[[Operation], float | None],
        most_bytes: Mapping[str, int],
    ) -> None:
        self._decisions = decisions
        self._calling = calling
        self._line = line
        self._journal = journal
        self._tell = tell
        self._reach_s = reach_s
        self._most_bytes = most_bytes
        self._waiters: list[_Waiter] = []

    @property
    def waiting(self) -> list[Operation]:
        """The operations of the calls that wait, the oldest first."""
        return [waiter.operation for waiter in self._waiters]

    async def answer(self, asked: Invocation, hearing: Hearing, *, urgent: bool) -> Any:
        """A server's decoded reply, or a NoAnswer."""
        patience, asked_s = asked.method.patience, now_s()
        within_s = patience.within_s if patience is not None else None
        self._tell(CallWaits(asked.operation))
        limit = asyncio.timeout_at(None if within_s is None else asked_s + within_s)
        waiter = _Waiter(asked, limit)
        self._waiters.append(waiter)
        listening: asyncio.Task[None] | None = None
        try:
            async with limit:
                self._keep_within(asked.operation.service)
                listening = begin(self._listen(waiter, hearing))
                if (reply := await self._by_server(asked, waiter, asked_s, urgent=urgent)) is not None:
                    return reply
        except TimeoutError:
            pass
        finally:
            self._waiters.remove(waiter)
            self._tell(CallOver(asked.operation))
            await end(listening)
        return self.unanswered(asked, waiter.why or f"no server answered within {within_s:g} s", asked_s)

    async def _listen(self, waiter: _Waiter, hearing: Hearing) -> None:
        """End the call when the mission drops it, or waits for it where no server answers."""
        await first(hearing.enough.wait(), hearing.waits.wait())
        if not hearing.enough.is_set():
            self._hurry(waiter)
            await hearing.enough.wait()
        waiter.end("the mission dropped it")

    def unanswered(self, asked: Invocation, why: str, asked_s: float) -> NoAnswer:
        """Log a call that ends without an answer."""
        patience = asked.method.patience
        self._journal.record(
            schema.Unanswered(
                waypoint=asked.waypoint,
                operation=str(asked.operation),
                at_s=asked_s,
                waited_s=now_s() - asked_s,
                within_s=patience.within_s if patience is not None else None,
                why=why,
            )
        )
        return NoAnswer(why)

    async def _by_server(
        self, asked: Invocation, waiter: _Waiter, asked_s: float, *, urgent: bool
    ) -> Any | None:
        raised = False
        while True:
            async with self._line.turn(asked.operation, urgent=urgent, since_s=asked_s) as turn:
                began_s = now_s()
                decision = self._decisions.decide(asked.operation, waypoint=asked.waypoint)
                if isinstance(decision, Remote):
                    turn.take(decision)
                    answer = await self._calling.by_server(decision, asked, raised_before=raised)
                    if not isinstance(answer, str):
                        attempt = answer.attempt
                        self._journal.record(
                            schema.Call(
                                waypoint=asked.waypoint,
                                operation=str(asked.operation),
                                place=decision.server,
                                check=attempt.check if attempt is not None else None,
                                decision=decision.why + (attempt.told_of_sending if attempt else ""),
                                at_s=asked_s,
                                delay_s=now_s() - asked_s,
                                waited_s=0.0,
                                onboard_s=0.0,
                                wait="",
                                fell_back=False,
                                queued_s=began_s - asked_s or None,
                                **(attempt.facts_of_sending if attempt else {}),
                            )
                        )
                        return answer.reply
                    if raised and answer:
                        waiter.why = f"{answer}, as at the attempt before"
                        return None
                    raised |= bool(answer)
            if not isinstance(decision, Remote):
                await self._decisions.told()  # what the policy thinks of this server may change then
            self._tell(CallWaits(asked.operation, again=True))

    def _hurry(self, waiter: _Waiter) -> None:
        """The mission waits for this call: without a deadline it waits only while a server in range can answer."""
        if waiter.has_deadline:
            return
        reach_s = self._reach_s(waiter.operation)
        if reach_s is None:
            waiter.end("no server in range can answer, and the mission waits")
        else:
            limit_s = max(_LEAST_S, _FACTOR * reach_s * len(self._waiters))
            waiter.end(f"no server in range answered within {limit_s:.0f} s", in_s=limit_s)

    def _keep_within(self, service: str) -> None:
        """End the oldest calls of a service whose requests need more memory than they may."""
        its = [waiter for waiter in self._waiters if waiter.operation.service == service]
        size_bytes, most_bytes = sum(waiter.size_bytes for waiter in its), self._most_bytes[service]
        for waiter in its:
            if size_bytes <= most_bytes:
                return
            waiter.end(f"calls that wait for a server keep more than service.waiting_bytes = {most_bytes}")
            size_bytes -= waiter.size_bytes

    async def soon_s(self, operation: Operation) -> float | None:
        """Seconds until a call made now is answered here; None if a stop is not worth it."""
        reach_s, alone_s = (
            self._reach_s(operation),
            self._decisions.selection.estimates.alone_s(operation),
        )
        if reach_s is None or alone_s is None:
            return None
        soon_s = reach_s * max(1, len(self._waiters))
        return soon_s if soon_s <= alone_s else None

    def end(self, why: str) -> None:
        """End all calls that wait."""
        for waiter in list(self._waiters):
            waiter.end(why)

    async def end_all(self, why: str) -> None:
        """The same; return when they are over."""
        self.end(why)
        while self._waiters:
            await self._decisions.told()

    async def answered_here(self, at_most_s: float = math.inf) -> None:
        """Return when no call waits, or when no server in range answers the next one, and after that time at most."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(at_most_s if at_most_s < math.inf else None):
                while self._waiters:
                    reaches = [self._reach_s(operation) for operation in dict.fromkeys(self.waiting)]
                    reach_s = max((reach_s for reach_s in reaches if reach_s is not None), default=None)
                    if reach_s is None:
                        return
                    count = len(self._waiters)
                    async with asyncio.timeout(max(_LEAST_S, _FACTOR * reach_s)):
                        while len(self._waiters) == count:
                            await self._decisions.told()
