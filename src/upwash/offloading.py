"""PROGRAM: runs each service call on the drone or on a server, and looks for servers in the background.

The deciding is done by core/selection.py; this carries its commands out and tells it what came of them.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import msgspec

from upwash.core.estimates import Operation
from upwash.core.policy import Decision, Remote, Wait
from upwash.core.selection import (
    Check,
    CheckAnswered,
    CheckFailed,
    Command,
    Happening,
    Leave,
    LocalCallEnded,
    Looked,
    MissionEnded,
    NetworkLost,
    RemoteCallCut,
    RemoteCallEnded,
    RemoteCallFailed,
    Selection,
    ServicesStarted,
    Start,
)
from upwash.core.servers import Change, State
from upwash.errors import AutopilotLost, DeadlineExceeded, LinkError, NetworkError
from upwash.onboard import PLACE, OnboardServices
from upwash.ports import Autopilot, Dialer, Journal, Network
from upwash.service import Method
from upwash.visit import Contact, Visit

_CHECK_LEAST_S = 10.0
_CHECK_FACTOR = 3.0  # times the estimate: a check that takes longer has failed
_LOCAL_LEAST_S = 30.0
_LOCAL_FACTOR = 10.0  # times the estimate: a local call that takes longer hangs


@dataclass(frozen=True, slots=True)
class Outcome:
    """One call, as the mission experienced it."""

    operation: Operation
    place: str  # "local" or the server's name
    decision: str
    at_s: float
    delay_s: float
    waited_s: float
    onboard_s: float  # of the delay, what the drone's own service took
    wait: str  # "", "paid off" or "failed"
    fell_back: bool


class Offloading:
    """One drone's calls and its business with servers."""

    def __init__(
        self,
        selection: Selection,
        contacts: Mapping[str, Contact],
        *,
        period_s: float,
        autopilot: Autopilot,
        network: Network,
        dialer: Dialer,
        onboard: OnboardServices,
        journal: Journal,
    ) -> None:
        self._selection = selection
        self._contacts = contacts
        self._period_s = period_s
        self._autopilot = autopilot
        self._network = network
        self._dialer = dialer
        self._onboard = onboard
        self._journal = journal
        self._orders: asyncio.Queue[Check | Start | Leave] = asyncio.Queue()
        self._visit: Visit | None = None
        self._errand: asyncio.Task[None] | None = None  # what the visit is busy with
        self._watch: asyncio.Task[None] | None = None  # over the network that the visit joined
        self._cut: RemoteCallCut | None = None  # the call that ended the visit by taking too long
        self._look_now = asyncio.Event()
        self._changed = asyncio.Event()

    async def run(self) -> NoReturn:
        """Looks for servers and visits them, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._look())
            tasks.create_task(self._watch_borders())
            tasks.create_task(self._carry_out())
        raise AssertionError("these tasks never end by themselves")

    async def end(self) -> None:
        """Leaves whatever server is selected; to be called while `run` runs, after the last call."""
        self.tell(MissionEnded())
        await self._orders.join()

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
        reply, place, fell_back, onboard_s = None, PLACE, False, 0.0
        if isinstance(decision, Remote):
            reply, place = await self._call_server(decision, operation, method, request), decision.server
            if reply is None:
                why, fell_back = f"{why}; no usable answer, so on the drone", True
        if reply is None:
            onboard_since_s = self._now_s()
            reply, place = await self._call_onboard(operation, method, request), PLACE
            onboard_s = self._now_s() - onboard_since_s
        delay_s = self._now_s() - began_s
        self._report(Outcome(operation, place, why, began_s, delay_s, waited_s, onboard_s, wait, fell_back))
        return reply

    def _report(self, outcome: Outcome) -> None:
        facts = msgspec.to_builtins(outcome)
        self._journal.record("call", **{**facts, "operation": str(outcome.operation)})

    # --- deciding -------------------------------------------------------------------------------------------

    def _decide(self, operation: Operation) -> Decision:
        decision, commands = self._selection.decide(
            operation, now_s=self._now_s(), position=self._autopilot.position
        )
        self._decided(operation, decision, commands)
        return decision

    async def _wait(self, operation: Operation, wait: Wait) -> Decision:
        check = self._selection.check
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

    def _perform(self, commands: Sequence[Command]) -> None:
        for command in commands:
            if isinstance(command, Change):
                self._record_change(command)
            else:
                self._orders.put_nowait(command)
        if commands:
            self._changed.set()
            self._changed = asyncio.Event()

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

    async def _call_server(
        self, decision: Remote, operation: Operation, method: Method, request: bytes
    ) -> Any | None:
        """The decoded reply of a server, or None where it gave no usable one."""
        check, visit, began_s = self._selection.check, self._visit, self._now_s()
        assert visit is not None  # noqa: S101 - a server is READY only by its visit
        try:
            reply = method.decode(
                await visit.call(operation.service, operation.method, request, deadline_s=decision.deadline_s)
            )
        except LinkError as error:
            self._journal.record("remote_failed", server=decision.server, why=str(error))
            if isinstance(error, DeadlineExceeded):
                self._cut = RemoteCallCut(decision.server, operation, self._now_s() - began_s)
            self.tell(RemoteCallFailed(decision.server, check, str(error)))
            return None
        self.tell(RemoteCallEnded(decision.server, operation, self._now_s() - began_s))
        return reply

    async def _call_onboard(self, operation: Operation, method: Method, request: bytes) -> Any:
        began_s = self._now_s()
        expected_s = self._selection.estimates.local_s(operation) or 0.0
        reply = method.decode(
            await self._onboard.call(
                operation.service,
                operation.method,
                request,
                timeout_s=max(_LOCAL_LEAST_S, _LOCAL_FACTOR * expected_s),
            )
        )
        self.tell(LocalCallEnded(operation, self._now_s() - began_s))
        return reply

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

    async def _carry_out(self) -> None:
        """Carries out what concerns the radio, one order after the other."""
        try:
            while True:
                order = await self._orders.get()
                try:
                    await self._follow(order)
                finally:
                    self._orders.task_done()
        finally:
            await _stop(self._errand)
            await _stop(self._watch)

    async def _follow(self, order: Check | Start | Leave) -> None:
        match order:
            case Check(server, check):
                self._visit = Visit(self._contacts[server], network=self._network, dialer=self._dialer)
                self._errand = asyncio.create_task(self._ask(self._visit, server, check))
            case Start(server, check) if self._visit is not None:
                self._errand = asyncio.create_task(self._start(self._visit, server, check))
            case Leave(server):
                await _stop(self._errand)
                if self._visit is not None:
                    answered = await self._visit.end(in_range=self._selection.servers[server].in_range)
                    if answered and self._cut is not None:
                        self.tell(self._cut)
                await _stop(self._watch)
                self._visit = self._errand = self._watch = self._cut = None

    async def _ask(self, visit: Visit, server: str, check: int) -> None:
        try:
            await visit.join(timeout_s=self._limit_s(server, running=True))
            self._journal.record("joined", server=server, network=self._contacts[server].network)
            self._watch = asyncio.create_task(self._notice_loss(visit, check))
            running = await visit.ask()
        except (NetworkError, LinkError) as error:
            self.tell(CheckFailed(check, str(error)))
            return
        self.tell(CheckAnswered(check, running))
        if running:
            await visit.keep_lease()

    async def _notice_loss(self, visit: Visit, check: int) -> None:
        self.tell(NetworkLost(check, await visit.lost()))

    async def _start(self, visit: Visit, server: str, check: int) -> None:
        limit_s = self._limit_s(server, running=False)
        try:
            await visit.start(timeout_s=limit_s)
        except LinkError as error:
            self.tell(CheckFailed(check, str(error)))
            return
        self.tell(ServicesStarted(check))
        await visit.keep_lease()

    def _limit_s(self, server: str, *, running: bool) -> float:
        """How long joining may take, for which it matters nothing whether the services run; or else starting."""
        return max(_CHECK_LEAST_S, _CHECK_FACTOR * self._selection.estimates.check_s(server, running=running))

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()


async def _stop(task: asyncio.Task[None] | None) -> None:
    """Cancels the task and waits for its end; raises what else it ended with."""
    if task is not None:
        task.cancel()
        (ended,) = await asyncio.gather(
            task, return_exceptions=True
        )  # which is cancelled only by our own caller
        if isinstance(ended, Exception):
            raise ended
