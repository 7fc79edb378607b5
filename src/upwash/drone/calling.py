"""One call at one place: at a server, or at the drone's own service."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Lightened
from upwash.core.selection.events import (
    Reached,
    RemoteCallCut,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
    TurnOver,
)
from upwash.core.selection.hedging import Hedging
from upwash.drone.decisions import Decisions, now_s
from upwash.drone.onboard import OnboardServices
from upwash.drone.radio_worker import RadioWorker
from upwash.drone.radios import Radios
from upwash.drone.server_session import ServerSession
from upwash.errors import UNREACHED, DeadlineExceeded, LinkError, NoLease
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method

RemoteFault: TypeAlias = Literal["", "confirmed", "denied"]  # by the drone's own service
_LOCAL_LEAST_S = 30.0
_LOCAL_FACTOR = 10.0  # times the estimate: a local call that takes longer hangs


@dataclass(frozen=True, slots=True)
class Call:
    """What the mission asked for, or, where it is `lightened`, less than that."""

    operation: Operation
    method: Method
    request: bytes
    lightened: Lightened | None = None

    def lighter(self, lightened: Lightened | None) -> Call:
        """The same call as the lighter operation, if there is one."""
        if lightened is None:
            return self
        request = self.method.under(lightened.operation.key, self.request)
        return Call(lightened.operation, self.method, request, lightened)


@dataclass(frozen=True, slots=True)
class Said:
    """What a server says that the service raised in a call, and after how long."""

    raised: str
    delay_s: float


@dataclass(slots=True)
class Attempt:
    """A call to a server, bound to the check that made it READY, and the drone's own service at the same call."""

    call: Call
    server: str
    worker: RadioWorker
    session: ServerSession
    check: int
    deadline_s: float
    position: Position  # of the drone when it was made
    reply: asyncio.Task[Any] | None = None  # where it is not simply waited for
    rival: asyncio.Task[Any] | None = None  # the drone's own service
    said: Said | None = None
    verdict: RemoteFault = ""  # on what it said

    @property
    def late(self) -> bool:
        """Whether the drone's own service has answered."""
        return self.rival is not None and self.rival.done() and not has_failed(self.rival)


class Calling:
    """Makes calls, and tells what came of those to servers."""

    def __init__(
        self,
        decisions: Decisions,
        radios: Radios,
        onboard: OnboardServices,
        journal: Journal,
        hedging: Hedging | None,
    ) -> None:
        self._decisions = decisions
        self._radios = radios
        self._onboard = onboard
        self._journal = journal
        self._hedging = hedging

    def attempt(self, call: Call, server: str, deadline_s: float) -> Attempt:
        """An attempt at the server, which is READY; it is not begun."""
        worker = self._radios.worker_at(server)
        assert worker.session is not None  # noqa: S101 - a server is READY only by its session
        return Attempt(
            call,
            server,
            worker,
            worker.session,
            self._decisions.check_of(server),
            deadline_s,
            self._decisions.position,
        )

    async def at_server(self, attempt: Attempt) -> Any | None:
        """The decoded reply of a server that carries a value, or None where it gave no such reply."""
        call, server, began_s = attempt.call, attempt.server, now_s()
        operation, method = call.operation, call.method
        try:
            answer = await attempt.session.call(
                operation.service, operation.method, call.request, deadline_s=attempt.deadline_s
            )
            reply = method.decode(answer)
        except NoLease as error:
            self._decisions.tell(TurnOver(attempt.check, str(error), in_call=True))
            return None
        except LinkError as error:
            self._journal.record(schema.RemoteFailed(server=server, check=attempt.check, why=str(error)))
            if isinstance(error, DeadlineExceeded):
                attempt.worker.cut = RemoteCallCut(server, operation, now_s() - began_s)
            self._decisions.tell(RemoteCallFailed(server, attempt.check, str(error), attempt.late))
            if isinstance(error, UNREACHED):
                self._reached(attempt, now_s() - began_s, None)
            return None
        delay_s = now_s() - began_s
        if raised := method.raised(reply):
            attempt.said = Said(raised, delay_s)
            self._doubt(attempt, attempt.said)
            self._reached(attempt, delay_s, len(answer))
            return None
        if attempt.late:
            self._journal.record(schema.Dropped(operation=str(operation), place=server))
        if self._hedging is not None:
            self._hedging.answered(server, operation, delay_s)
        self._decisions.tell(RemoteCallEnded(server, operation, delay_s, attempt.late))
        self._reached(attempt, delay_s, len(answer))
        return reply

    async def onboard(self, call: Call) -> Any:
        """The decoded reply of the drone's own service; raises InstanceError where that fails."""
        expected_s = self._decisions.estimates.local_s(call.operation) or 0.0
        return call.method.decode(
            await self._onboard.call(
                call.operation.service,
                call.operation.method,
                call.request,
                timeout_s=max(_LOCAL_LEAST_S, _LOCAL_FACTOR * expected_s),
                once=call.method.once,
            )
        )

    def test(self, attempt: Attempt, onboard: Any) -> None:
        """Holds what the server said, if it did, against what the drone's own service replied to the same call."""
        if (said := attempt.said) is None or attempt.verdict:
            return
        server, operation = attempt.server, attempt.call.operation
        confirmed = bool(attempt.call.method.raised(onboard))
        attempt.verdict = "confirmed" if confirmed else "denied"
        why = f"it says that {operation} raised {said.raised}, which did not raise on the drone"
        if not confirmed:
            attempt.session.deny(operation.service)
            self._journal.record(
                schema.RemoteFailed(server=server, check=attempt.check, why=f"{server}: {why}")
            )
        elif self._hedging is not None:
            self._hedging.answered(server, operation, said.delay_s)
        self._decisions.tell(
            RemoteFaultTested(server, attempt.check, operation, said.delay_s, why, confirmed)
        )

    def _reached(self, attempt: Attempt, delay_s: float, answer_bytes: int | None) -> None:
        """Tells with how much the server answered where the drone was, if it did, after all else of the call."""
        call, server = attempt.call, attempt.server
        if not self._decisions.estimates.is_measured(server):
            return
        size_bytes = len(call.request) + (answer_bytes or 0)
        answered = answer_bytes is not None
        self._decisions.tell(Reached(server, attempt.position, answered, call.operation, delay_s, size_bytes))

    def _doubt(self, attempt: Attempt, said: Said) -> None:
        """Notes what the server says that the service raised; the mission hears only what the drone's own raises."""
        server, rival = attempt.server, attempt.rival
        operation = str(attempt.call.operation)
        self._journal.record(
            schema.RemoteRaised(server=server, check=attempt.check, operation=operation, raised=said.raised)
        )
        if rival is not None and attempt.late:
            self.test(attempt, rival.result())
        else:
            why = f"{server} says that {operation} raised {said.raised}"
            self._decisions.tell(RemoteCallRaised(server, why))


def has_failed(call: asyncio.Task[Any]) -> bool:
    """Whether the call is over without an answer."""
    return call.done() and (call.cancelled() or call.exception() is not None or call.result() is None)
