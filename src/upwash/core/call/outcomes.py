"""What attempts at servers teach: the selection, hedging, deadlines and the log get each outcome.

Where the drone computes the same call, its own service tests an exception that a server reports. An exception of the
call itself counts as an answer. Any other exception is a failure of the server.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt
from upwash.core.call.twice import Twice
from upwash.core.operation import Operation
from upwash.core.selection import events
from upwash.eventlog import schema

if TYPE_CHECKING:
    from upwash.core.call.calls import Calls

Outcome: TypeAlias = steps.RequestReduced | steps.Replied | steps.TurnedAway | steps.SlotLost | steps.Failed


class Outcomes:
    """Tells what has come of one drone's attempts at servers, and then has the call go on."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls

    def take_in(self, event: Outcome) -> None:
        """Take in what has come of an attempt."""
        match event:
            case steps.RequestReduced():
                self._reduced(event)
            case steps.Replied():
                self._replied(event)
            case steps.TurnedAway():
                self._not_begun(event)
            case steps.SlotLost(attempt, why):
                self._calls.tell(events.SlotTaken(attempt.check, why, in_call=True))
                attempt.call.tried(attempt, "failed")
            case steps.Failed():
                self._failed(event)

    def _reduced(self, event: steps.RequestReduced) -> None:
        """Send what the part before sending has left, if the server is still of use."""
        attempt, calls = event.attempt, self._calls
        attempt.part_s, attempt.sent_bytes = calls.now_s - attempt.begun_s, event.size_bytes
        attempt.sends_less = event.is_less
        if event.why:
            self.part_failed(attempt.operation, event.why)
        left_s, expected_s = attempt.deadline_s - attempt.part_s, 0.0
        if not attempt.sends_less:
            attempt.counts_from_s = calls.now_s
            expected_s = calls.estimates.remote_s(attempt.server, attempt.operation) or 0.0
        may_send = not attempt.call.is_over and calls.placement.may_send(attempt.server, attempt.check)
        if may_send and expected_s <= left_s:
            calls.send(attempt, left_s)
        else:
            attempt.call.tried(attempt, "failed")

    def _replied(self, reply: steps.Replied) -> None:
        attempt = reply.attempt
        call, delay_s = attempt.call, self._calls.now_s - attempt.counts_from_s
        if reply.raised:
            attempt.raised, attempt.delay_s = reply.raised, delay_s
            self._doubt(attempt)
            self._reached(attempt, delay_s, reply.size_bytes)
            call.tried(attempt, "raised")
            return
        is_late, less = call.is_late(attempt), attempt.sends_less
        if is_late and (not isinstance(call.manner, Twice) or call.is_over):
            self._calls.do(schema.Dropped(operation=str(attempt.operation), place=attempt.server))
        self._calls.deadlines.answered(attempt.server, attempt.operation, delay_s)
        self._calls.hedging.answered(attempt.server, attempt.operation, delay_s, less=less)
        self._calls.tell(
            events.RemoteCallEnded(
                attempt.server,
                attempt.operation,
                delay_s,
                is_late,
                less,
                min(reply.queued_s, delay_s),
                reply.queue_s,
            )
        )
        self._reached(attempt, delay_s, reply.size_bytes)
        call.tried(attempt, "answered")

    def _not_begun(self, event: steps.TurnedAway) -> None:
        attempt, why, queue_s = event.attempt, event.why, event.queue_s
        waited_s, is_late = self._calls.now_s - attempt.counts_from_s, attempt.call.is_late(attempt)
        self._calls.do(
            schema.RemoteQueued(
                waypoint=attempt.call.asked.waypoint,
                server=attempt.server,
                check=attempt.check,
                waited_s=waited_s,
                queue_s=queue_s,
                why=why,
            )
        )
        self._calls.tell(events.RemoteCallQueued(attempt.server, why, waited_s, queue_s, is_late))
        attempt.call.tried(attempt, "queued")

    def _failed(self, failure: steps.Failed) -> None:
        attempt, why = failure.attempt, failure.why
        delay_s = self._calls.now_s - attempt.counts_from_s
        self._calls.do(schema.RemoteFailed(server=attempt.server, check=attempt.check, why=why))
        if failure.cut:
            cut = events.RemoteCallCut(attempt.server, attempt.operation, delay_s, attempt.sends_less)
            self._calls.do(steps.Cut(attempt, cut))
        self._call_failed(attempt, why)
        self._calls.deadlines.answered(attempt.server, attempt.operation, math.inf)
        if failure.unreached:
            self._reached(attempt, delay_s, None)
        attempt.call.tried(attempt, "failed")

    def _call_failed(self, attempt: Attempt, why: str) -> None:
        is_late = attempt.call.is_late(attempt)
        self._calls.tell(events.RemoteCallFailed(attempt.server, attempt.check, why, is_late))

    def _reached(self, attempt: Attempt, delay_s: float, answer_bytes: int | None) -> None:
        """Tell the selection how fast the server answered at this place, for a server without a range."""
        if self._calls.estimates.is_measured(attempt.server):
            self._calls.tell(
                events.Reached(
                    attempt.server,
                    attempt.position,
                    answer_bytes is not None,
                    attempt.operation,
                    delay_s,
                    (attempt.sent_bytes or attempt.size_bytes) + (answer_bytes or 0),
                    attempt.sends_less,
                )
            )

    def part_failed(self, operation: Operation, why: str) -> None:
        """Note that the part before sending failed, or may have caused an exception."""
        self._calls.tell(events.PartFailed(operation.service))
        again = self._calls.estimates.tries_part(operation.service)
        self._calls.do(schema.SentWhole(operation=str(operation), why=why, given_up=not again))

    def _doubt(self, attempt: Attempt) -> None:
        """Log the exception. The mission gets exceptions of the drone's own service alone."""
        call, operation = attempt.call, attempt.operation
        why = f"{attempt.server} says that {operation} raised {attempt.raised}"
        if call.asked.on_servers:  # the drone cannot test it
            self._calls.do(schema.RemoteFailed(server=attempt.server, check=attempt.check, why=why))
            return
        self._calls.do(
            schema.RemoteRaised(
                server=attempt.server, check=attempt.check, operation=str(operation), raised=attempt.raised
            )
        )
        if isinstance(call.manner, Twice):  # the drone computes another operation, which tests nothing
            if attempt.sends_less:  # which may be the fault of what was sent
                self.part_failed(operation, why)
            else:
                self._call_failed(attempt, why)
        elif not call.is_late(attempt):
            self._calls.tell(events.RemoteCallRaised(attempt.server, why))
        elif call.own is not None and call.own.state == "answered" and call.winner is None:
            self.test(attempt, raised=call.own.raised)
        else:  # another server answered
            self._call_failed(attempt, why)

    def test(self, attempt: Attempt, *, raised: str) -> None:
        """Compare the exception that the server reported with the drone's own result of the same call."""
        operation, confirmed = attempt.operation, bool(raised)
        attempt.verdict = "confirmed" if confirmed else "denied"
        why = f"it says that {operation} raised {attempt.raised}, which did not raise on the drone"
        if confirmed:
            self._calls.hedging.answered(attempt.server, operation, attempt.delay_s, less=attempt.sends_less)
        elif attempt.sends_less:  # which may be the fault of what was sent
            self.part_failed(operation, f"{attempt.server} says that it raised {attempt.raised} then")
            return
        else:
            self._calls.do(steps.Deny(attempt))
            self._calls.do(
                schema.RemoteFailed(
                    server=attempt.server, check=attempt.check, why=f"{attempt.server}: {why}"
                )
            )
        self.blame(attempt, why, confirmed=confirmed)

    def blame(self, attempt: Attempt, why: str, *, confirmed: bool) -> None:
        """Tell the selection whether an exception that a server reported is the call's own, or the server's fault."""
        self._calls.tell(
            events.RemoteFaultTested(
                attempt.server,
                attempt.check,
                attempt.operation,
                attempt.delay_s,
                why,
                confirmed,
                attempt.sends_less,
            )
        )
