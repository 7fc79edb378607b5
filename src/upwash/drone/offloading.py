"""PROGRAM: runs each service call on the drone or on a server, and selects servers in the background.

core/selection/ decides. decisions.py passes what is decided about servers on to the radios (radios.py,
radio_worker.py); calls are made by calling.py and raced by racing.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Literal, NoReturn, TypeVar

from upwash.core.geo import Circle
from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.policies.policy import Remote, Wait
from upwash.core.selection.events import NoMoreCalls, SelectionEvent
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.selection import Selection
from upwash.drone.calling import CallAnswer, Calling, Invocation, Racing
from upwash.drone.decisions import Background, Decisions, now_s
from upwash.drone.onboard import OnboardServices
from upwash.drone.radios import RadioWorkers
from upwash.drone.server_session import ServerEndpoint
from upwash.errors import TransitionError, UpwashError
from upwash.eventlog import schema
from upwash.ports import Autopilot, Dialer, Journal, Network
from upwash.rpc.service import Method
from upwash.support.background import end, first, start

T = TypeVar("T")


class Offloading:
    """Makes one drone's calls, and selects, checks and leaves servers for them."""

    def __init__(
        self,
        selection: Selection,
        endpoints: Mapping[str, ServerEndpoint],
        *,
        period_s: float,
        autopilot: Autopilot,
        networks: Sequence[Network],
        dialer: Dialer,
        onboard: OnboardServices,
        journal: Journal,
        hedging: Hedging,
    ) -> None:
        self._journal = journal
        self._radios = RadioWorkers(
            lambda server: selection.servers[server].in_range,
            endpoints,
            networks=networks,
            dialer=dialer,
            journal=journal,
            tell=self.tell,
        )
        self._decisions = Decisions(selection, autopilot=autopilot, journal=journal, send=self._radios.send)
        self._background = Background(
            self._decisions,
            [server.area for server in selection.servers.values() if isinstance(server.area, Circle)],
            period_s=period_s,
            autopilot=autopilot,
            journal=journal,
        )
        self._calling = Calling(self._decisions, self._radios, onboard, journal, hedging)
        self._racing = Racing(self._decisions, self._calling, journal, hedging)

    async def run(self) -> NoReturn:
        """Selects servers and carries out the core's commands, until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._background.look())
                tasks.create_task(self._background.watch_borders())
                for worker in self._radios.workers:
                    tasks.create_task(worker.run())
        finally:
            await self._racing.stop_losers()
        raise AssertionError("these tasks never end by themselves")

    async def end(self) -> None:
        """Leave the selected server; call it while `run` runs, after the last call."""
        await self._racing.stop_losers()
        self.tell(NoMoreCalls())
        await self._radios.done()

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use, and the round-trip time (s) of the last request to its daemon; None if unknown."""
        server = self._decisions.server_in_use
        if server is None:
            return None, None
        return server, self._radios.worker_at(server).round_trip_s(server)

    def tell(self, event: SelectionEvent) -> None:
        """Pass the event to the core, and carry out its commands."""
        self._decisions.tell(event)

    def outlook(self) -> Outlook | None:
        """What flying on before the open call is over would save and cost; None if nothing is known."""
        return self._decisions.outlook()

    async def invoke(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call where it is decided to run, and on the drone if that fails; returns its decoded reply.

        Raises InstanceError only if the drone's own service fails too.
        """
        began_s = now_s()
        decision = self._decisions.decide(operation)
        call = Invocation(operation, method, request).lighter(decision.inputs.lightened)
        wait: Literal["", "paid off", "failed"] = ""
        why = decision.why
        if isinstance(decision, Wait):
            decision = await self._decisions.wait(call.operation, decision)
            wait = "paid off" if isinstance(decision, Remote) else "failed"
            why = f"{why}: {decision.why}"
        waited_s = now_s() - began_s
        answer = await self._racing.answer(decision, call)
        if answer.server is None and isinstance(decision, Remote):
            why = f"{why}; {_lost(answer)} on the drone"
        elif answer.overtook:
            why = f"{why}; {answer.server} became of use, and was sooner"
        lightened = answer.call.lightened
        self._journal.record(
            schema.Call(
                operation=str(answer.call.operation),
                place=name_of(answer.server),
                check=answer.attempt.check if answer.attempt is not None else None,
                decision=why,
                at_s=began_s,
                delay_s=now_s() - began_s,
                waited_s=waited_s,
                onboard_s=answer.onboard_s,
                wait=wait,
                fell_back=answer.fell_back,
                hedged_s=answer.hedged_s,
                queued_s=answer.queued_s or None,
                remote_fault=answer.remote_fault,
                **(lightened.facts if lightened else {}),
            )
        )
        return answer.reply

    async def invoke_alone(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call on the drone without a decision: a method that runs once, or after a defect of offloading."""
        began_s = now_s()
        queued_s = await self._racing.queue(operation.service)
        reply = await self._calling.onboard(Invocation(operation, method, request))
        delay_s = now_s() - began_s
        self._journal.record(
            schema.Call(
                operation=str(operation),
                place=ON_DRONE,
                decision="it runs once, and on the drone" if method.once else "offloading has failed",
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


def _lost(answer: CallAnswer) -> str:
    if answer.remote_fault:
        return f"it raised there, which was {answer.remote_fault}"
    return "no usable answer, so" if answer.fell_back else "late, and sooner"


class FailSafeOffloading:
    """Offloading whose defects are logged and switch it off: the mission goes on, and calls run on the drone."""

    def __init__(self, offloading: Offloading, journal: Journal) -> None:
        self._offloading = offloading
        self._journal = journal
        self._failed = False
        self._background: asyncio.Task[Any] | None = None

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Offload until the end of the block; then leave the selected server."""
        background = self._background = start(self._offloading.run(), name="offloading", failed=self._fail)
        try:
            yield
        finally:
            await self._end(background)
            await end(background)

    async def invoke(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call where it is decided to run, or on the drone; returns its decoded reply.

        A method that runs once runs on the drone without a decision, so that no defect repeats it. Raises
        InstanceError only if the drone's own service fails.
        """
        if not self._failed and not method.once:
            try:
                return await self._offloading.invoke(operation, method, request)
            except Exception as error:
                if not _is_defect(error):
                    raise
                self._fail(error)
        return await self._offloading.invoke_alone(operation, method, request)

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use, and the round-trip time (s) to its daemon; None if unknown or switched off."""
        return (None, None) if self._failed else self._offloading.link

    def outlook(self) -> Outlook | None:
        """What flying on before the open call is over would save and cost; None if nothing is known."""
        return self._guarded(self._offloading.outlook)

    def tell(self, event: SelectionEvent) -> None:
        """Pass the event on to the core."""
        self._guarded(lambda: self._offloading.tell(event))

    def _guarded(self, do: Callable[[], T]) -> T | None:
        if not self._failed:
            try:
                return do()
            except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
                self._fail(error)
        return None

    async def _end(self, background: asyncio.Task[Any]) -> None:
        """Leave the server, unless the background task has failed."""
        if background.done():
            return
        try:
            await first(self._offloading.end(), asyncio.wait([background]))
        except Exception as error:  # noqa: BLE001 - the mission was flown all the same
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        if self._failed:
            return
        self._failed = True
        if self._background is not None:
            self._background.cancel()
        defect: BaseException = error
        while isinstance(defect, BaseExceptionGroup):
            defect = defect.exceptions[0]
        trace = "".join(traceback.format_exception(error))
        self._journal.record(schema.OffloadingFailed(why=f"{type(defect).__name__}: {defect}", trace=trace))


def _is_defect(error: Exception) -> bool:
    return isinstance(error, TransitionError) or not isinstance(error, UpwashError)
