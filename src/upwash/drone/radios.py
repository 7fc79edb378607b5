"""The drone's radios: each has a worker that visits one server at a time and reports to the core.

The core decides which servers get a radio (core/selection/radios.py); `RadioWorkers` sends each command to the
worker at its server. A worker carries commands out one after the other.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn, TypeVar

from upwash.core.selection import events
from upwash.core.selection.commands import Check, Leave, Prepare, Probe, RadioCommand, Start
from upwash.core.selection.events import SelectionEvent
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import UNREACHED, LinkError, NetworkError, ServerFull, ServicePaused
from upwash.eventlog import schema
from upwash.ports import Dialer, Journal, Network
from upwash.support.background import begin, end, first

T = TypeVar("T")


@dataclass(eq=False)
class RadioWorker:
    """Visits one server at a time, with one radio.

    `cut` is the call that ended the session by taking too long. `told` waits for the core's next event, as when a
    border is crossed.
    """

    in_range: Callable[[str], bool]
    endpoints: Mapping[str, ServerEndpoint]
    network: Network
    dialer: Dialer
    journal: Journal
    tell: Callable[[SelectionEvent], None]
    told: Callable[[], Coroutine[Any, Any, None]]
    session: ServerSession | None = field(default=None, init=False)
    cut: events.RemoteCallCut | None = field(default=None, init=False)
    _commands: asyncio.Queue[RadioCommand] = field(default_factory=asyncio.Queue, init=False)
    _tasks: asyncio.TaskGroup = field(init=False)  # of `run`: the worker fails with any of them
    _exchange: asyncio.Task[None] | None = field(default=None, init=False)  # what the session is busy with
    _message: asyncio.Task[None] | None = field(default=None, init=False)  # for a peer of the server
    _watch: asyncio.Task[None] | None = field(default=None, init=False)  # over the session's network

    def round_trip_s(self, server: str) -> float | None:
        """The seconds of the last answered request to the server's daemon; None if elsewhere or unanswered."""
        if self.session is None or self.session.server != server:
            return None
        return self.session.round_trip_s

    def send(self, command: RadioCommand) -> None:
        """Queue the command behind the earlier ones."""
        self._commands.put_nowait(command)

    async def done(self) -> None:
        """Returns when every command is carried out; call it while `run` runs."""
        await self._commands.join()

    async def run(self) -> NoReturn:
        """Carries out the commands in their order, until cancelled."""
        async with asyncio.TaskGroup() as self._tasks:
            while True:
                command = await self._commands.get()
                try:
                    await self._follow(command)
                finally:
                    self._commands.task_done()
        raise AssertionError("it carries them out for ever")

    async def _follow(self, command: RadioCommand) -> None:
        match command:
            case Check(server):
                await self._pause()
                self._exchange = self._tasks.create_task(self._ask(self._session_at(server), command))
            case Probe(server):
                await self._pause()
                session = self._session_at(server)
                await session.tell_denied()
                await session.hang_up()
                self.cut = None  # which teaches nothing, as the server is probed
                self._exchange = self._tasks.create_task(self._probe(session, command))
            case Start() if self.session is not None:
                self._exchange = self._tasks.create_task(self._start(self.session, command))
            case Prepare() if self.session is not None:
                await end(self._message)
                self._message = self._tasks.create_task(self._prepare(self.session, command))
            case Leave(server):
                await end(self._message, self._exchange)
                if self.session is not None:
                    while self.session.calling and self.in_range(server):
                        await first(self.session.calls_over(), self.told())
                    answered = await self.session.end(in_range=self.in_range(server))
                    if answered and self.cut is not None:
                        self.tell(self.cut)
                await end(self._watch)
                self.session = self.cut = self._exchange = self._message = self._watch = None

    async def _pause(self) -> None:
        """Drop all work at the server, without leaving it."""
        await end(self._message, self._exchange, self._watch)
        self._message = self._exchange = self._watch = None

    def _session_at(self, server: str) -> ServerSession:
        if self.session is None or self.session.server != server:
            self.session = ServerSession(self.endpoints[server], network=self.network, dialer=self.dialer)
        return self.session

    async def _ask(self, session: ServerSession, command: Check) -> None:
        check = command.check
        try:
            await self._join(session, command)
            self._watch = self._tasks.create_task(self._watch_network(session, check))
            answer = await self._with_slot(session.ask, check)
        except (NetworkError, LinkError) as error:
            self.tell(_failed(check, error))
            return
        self.tell(events.CheckAnswered(check, session.running, tuple(answer.peers), answer.waiting))
        if session.running:
            await self._keep_lease(session, check)

    async def _with_slot(self, ask: Callable[[], Awaitable[T]], check: int) -> T:
        while True:
            try:
                return await ask()
            except ServerFull as refusal:
                self.tell(events.SlotRefused(check, refusal.waiting))
                await asyncio.sleep(refusal.ask_again_s)

    async def _keep_lease(self, session: ServerSession, check: int) -> None:
        before = 0

        def renewed(waiting: int) -> None:
            nonlocal before
            if waiting or before:
                self.tell(events.LeaseRenewed(check, waiting))
            before = waiting

        def moved(service: str) -> None:
            self.journal.record(schema.ServiceMoved(server=session.server, check=check, service=service))

        try:
            await session.keep_lease(renewed, moved)
        except ServerFull as refusal:
            self.tell(events.SlotTaken(check, str(refusal)))

    async def _join(self, session: ServerSession, command: Check | Probe) -> None:
        if await session.join(timeout_s=command.join_limit_s):
            network = self.endpoints[command.server].network
            self.journal.record(schema.Joined(server=command.server, network=network, check=command.check))

    async def _probe(self, session: ServerSession, command: Probe) -> None:
        """Return at the first reply. Probes overlap: a pending one does not delay the next."""
        asking: set[asyncio.Task[events.RadioEvent]] = set()
        asked = False
        try:
            for pause_s in command.probing.pauses_s(alone_s=command.alone_s):
                answered = await _first_success(asking, within_s=pause_s)
                if answered is not None:
                    self.tell(answered)
                    return
                if asked:
                    self.tell(events.ProbeUnanswered(command.check))
                asked = True
                asking = {task for task in asking if not task.done()}
                try:
                    await self._join(session, command)
                except NetworkError:
                    continue
                if self._watch is None or self._watch.done():
                    self._watch = self._tasks.create_task(self._watch_network(session, None))
                asking.add(begin(_question(session, command.check)))
        finally:
            await end(*asking)

    async def _watch_network(self, session: ServerSession, check: int | None) -> None:
        why = await session.lost()
        if check is not None:
            self.tell(events.NetworkGone(check, why))

    async def _start(self, session: ServerSession, command: Start) -> None:
        try:
            await self._with_slot(lambda: session.start(timeout_s=command.limit_s), command.check)
        except LinkError as error:
            self.tell(_failed(command.check, error))
            return
        self.tell(events.ServicesStarted(command.check))
        await self._keep_lease(session, command.check)

    async def _prepare(self, session: ServerSession, command: Prepare) -> None:
        try:
            await session.prepare(
                self.endpoints[command.peer], arrives_in_s=command.arrives_in_s, hold_s=command.hold_s
            )
        except LinkError as error:
            self.journal.record(schema.NotPrepared(server=command.peer, by=command.server, why=str(error)))
            return
        self.tell(events.PeerPrepared(command.peer, command.server))


def _failed(check: int, error: NetworkError | LinkError) -> events.ServerUnusable:
    pause_s = error.pause_s if isinstance(error, ServicePaused) else 0.0
    return events.ServerUnusable(check, str(error), isinstance(error, UNREACHED), pause_s)


async def _question(session: ServerSession, check: int) -> events.RadioEvent:
    try:
        return events.ProbeAnswered(check, await session.probe())
    except ServicePaused as refusal:
        return _failed(check, refusal)


async def _first_success(tasks: set[asyncio.Task[T]], *, within_s: float) -> T | None:
    """The result of the first task that raises no LinkError; None after `within_s`."""
    loop = asyncio.get_running_loop()
    until_s, left = loop.time() + within_s, set(tasks)
    while (left_s := until_s - loop.time()) > 0:
        if not left:
            await asyncio.sleep(left_s)
            break
        done, left = await asyncio.wait(left, timeout=left_s, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            if not isinstance(task.exception(), LinkError):
                return task.result()
    return None


class RadioWorkers:
    """The workers, one for each radio of the drone."""

    def __init__(self, workers: Sequence[RadioWorker]) -> None:
        self.workers = workers
        self._worker_of: dict[str, RadioWorker] = {}  # by the server that they are at, or were at last
        self._visited: list[str] = []  # the servers that a worker is at

    def worker_at(self, server: str) -> RadioWorker:
        """The worker that is at the server, or was the last one there."""
        return self._worker_of[server]

    def send(self, command: RadioCommand) -> None:
        """Gives the command to the worker that is at the command's server.

        If none is there, a free worker gets it: if possible the last one there, which first completes its leaving.
        """
        if isinstance(command, (Check, Probe)) and command.server not in self._visited:
            busy = [self._worker_of[server] for server in self._visited]
            free = [worker for worker in self.workers if worker not in busy]
            last = self._worker_of.get(command.server)
            self._worker_of[command.server] = last if last in free else free[0]
            self._visited.append(command.server)
        self._worker_of[command.server].send(command)
        if isinstance(command, Leave):
            self._visited.remove(command.server)

    async def done(self) -> None:
        """Returns when every command is carried out; call it while the workers run."""
        for worker in self.workers:
            await worker.done()
