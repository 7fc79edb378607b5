"""One radio's business with servers: it carries out orders one after the other, and tells what comes of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping
from typing import Any, NoReturn

from upwash.core.happenings import (
    CheckAnswered,
    CheckFailed,
    Happening,
    NetworkLost,
    Prepared,
    ProbeAnswered,
    RemoteCallCut,
    ServicesStarted,
)
from upwash.core.orders import Check, Leave, Order, Prepare, Probe, Start
from upwash.core.selection import Selection
from upwash.errors import LinkError, NetworkError
from upwash.ports import Dialer, Journal, Network
from upwash.visit import Contact, Visit

_CHECK_LEAST_S = 10.0
_CHECK_FACTOR = 3.0  # times the estimate: a check that takes longer has failed


class Envoy:
    """Visits one server at a time, with one radio."""

    def __init__(
        self,
        selection: Selection,
        contacts: Mapping[str, Contact],
        *,
        network: Network,
        dialer: Dialer,
        journal: Journal,
        tell: Callable[[Happening], None],
    ) -> None:
        self.visit: Visit | None = None
        self._visited = ""  # the server
        self.cut: RemoteCallCut | None = None  # the call that ended the visit by taking too long
        self._selection = selection
        self._contacts = contacts
        self._network = network
        self._dialer = dialer
        self._journal = journal
        self._tell = tell
        self._orders: asyncio.Queue[Order] = asyncio.Queue()
        self._errand: asyncio.Task[None] | None = None  # what the visit is busy with
        self._message: asyncio.Task[None] | None = None  # for a peer of the server
        self._watch: asyncio.Task[None] | None = None  # over the network that the visit joined

    def send(self, order: Order) -> None:
        """Has the order carried out after those that were given before."""
        self._orders.put_nowait(order)

    async def done(self) -> None:
        """Returns when every order is carried out; while `run` runs."""
        await self._orders.join()

    async def run(self) -> NoReturn:
        """Carries the orders out, until cancelled."""
        try:
            while True:
                order = await self._orders.get()
                try:
                    await self._follow(order)
                finally:
                    self._orders.task_done()
        finally:
            await self._pause()

    async def _follow(self, order: Order) -> None:
        match order:
            case Check(server, check):
                await self._pause()
                self._errand = asyncio.create_task(self._ask(self._visit(server), server, check))
            case Probe(server):
                await self._pause()
                visit = self._visit(server)
                await visit.hang_up()
                self.cut = None  # which teaches nothing, as the server is probed
                self._errand = asyncio.create_task(self._probe(visit, order))
            case Start(server, check) if self.visit is not None:
                self._errand = asyncio.create_task(self._start(self.visit, server, check))
            case Prepare() if self.visit is not None:
                await _stop(self._message)
                self._message = asyncio.create_task(self._prepare(self.visit, order))
            case Leave(server):
                await _stop(self._message)
                await _stop(self._errand)
                if self.visit is not None:
                    answered = await self.visit.end(in_range=self._selection.servers[server].in_range)
                    if answered and self.cut is not None:
                        self._tell(self.cut)
                await _stop(self._watch)
                self.visit = self.cut = self._errand = self._message = self._watch = None

    async def _pause(self) -> None:
        """Drops what is under way with the server, without leaving it."""
        for task in (self._message, self._errand, self._watch):
            await _stop(task)
        self._message = self._errand = self._watch = None

    def _visit(self, server: str) -> Visit:
        """The visit that goes on there, or a new one."""
        if self.visit is None or self._visited != server:
            self.visit = Visit(self._contacts[server], network=self._network, dialer=self._dialer)
            self._visited = server
        return self.visit

    async def _ask(self, visit: Visit, server: str, check: int) -> None:
        try:
            await self._join(visit, server)
            self._watch = asyncio.create_task(self._notice_loss(visit, check))
            answer = await visit.ask()
        except (NetworkError, LinkError) as error:
            self._tell(CheckFailed(check, str(error)))
            return
        self._tell(CheckAnswered(check, answer.running, answer.peers))
        if answer.running:
            await visit.keep_lease()

    async def _join(self, visit: Visit, server: str) -> None:
        if await visit.join(timeout_s=self._limit_s(server, running=True)):
            self._journal.record("joined", server=server, network=self._contacts[server].network)

    async def _probe(self, visit: Visit, order: Probe) -> None:
        """Returns at the first sign of life; a question that is not answered yet keeps the next one from nothing."""
        asking: set[asyncio.Task[ProbeAnswered]] = set()
        try:
            for pause_s in order.probing.pauses_s(alone_s=order.alone_s):
                answered = await _first_success(asking, within_s=pause_s)
                if answered is not None:
                    self._tell(answered)
                    return
                asking = {task for task in asking if not task.done()}
                try:
                    await self._join(visit, order.server)
                except NetworkError:
                    continue
                if self._watch is None or self._watch.done():
                    self._watch = asyncio.create_task(_until_lost(visit))
                asking.add(asyncio.create_task(self._question(visit, order.check)))
        finally:
            await end_all(asking)

    async def _question(self, visit: Visit, check: int) -> ProbeAnswered:
        return ProbeAnswered(check, await visit.probe())

    async def _notice_loss(self, visit: Visit, check: int) -> None:
        self._tell(NetworkLost(check, await visit.lost()))

    async def _start(self, visit: Visit, server: str, check: int) -> None:
        limit_s = self._limit_s(server, running=False)
        try:
            await visit.start(timeout_s=limit_s)
        except LinkError as error:
            self._tell(CheckFailed(check, str(error)))
            return
        self._tell(ServicesStarted(check))
        await visit.keep_lease()

    async def _prepare(self, visit: Visit, order: Prepare) -> None:
        """Costs nothing but the message: whether the next server can be used, its own check tells."""
        try:
            await visit.prepare(
                self._contacts[order.peer], arrives_in_s=order.arrives_in_s, hold_s=order.hold_s
            )
        except LinkError as error:
            self._journal.record("not_prepared", server=order.peer, by=order.server, why=str(error))
            return
        self._tell(Prepared(order.peer, order.server))

    def _limit_s(self, server: str, *, running: bool) -> float:
        """How long joining may take, for which it matters nothing whether the services run; or else starting."""
        return max(_CHECK_LEAST_S, _CHECK_FACTOR * self._selection.estimates.check_s(server, running=running))


async def _first_success(tasks: set[asyncio.Task[ProbeAnswered]], *, within_s: float) -> ProbeAnswered | None:
    """What the first of them returns, none of which raises more than a LinkError; None after that time."""
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


async def _until_lost(visit: Visit) -> None:
    await visit.lost()


async def end_all(tasks: Collection[asyncio.Task[Any]]) -> None:
    """Cancels the tasks and waits for their ends, whatever they are."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _stop(task: asyncio.Task[None] | None) -> None:
    """Cancels the task and waits for its end; raises what else it ended with."""
    if task is not None:
        task.cancel()
        (ended,) = await asyncio.gather(
            task, return_exceptions=True
        )  # which is cancelled only by our own caller
        if isinstance(ended, Exception):
            raise ended
