"""One radio's business with servers: it carries out orders one after the other, and tells what comes of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import NoReturn

from upwash.core.happenings import (
    CheckAnswered,
    CheckFailed,
    Happening,
    NetworkLost,
    Prepared,
    RemoteCallCut,
    ServicesStarted,
)
from upwash.core.orders import Check, Leave, Order, Prepare, Start
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
            for task in (self._message, self._errand, self._watch):
                await _stop(task)

    async def _follow(self, order: Order) -> None:
        match order:
            case Check(server, check):
                self.visit = Visit(self._contacts[server], network=self._network, dialer=self._dialer)
                self._errand = asyncio.create_task(self._ask(self.visit, server, check))
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

    async def _ask(self, visit: Visit, server: str, check: int) -> None:
        try:
            await visit.join(timeout_s=self._limit_s(server, running=True))
            self._journal.record("joined", server=server, network=self._contacts[server].network)
            self._watch = asyncio.create_task(self._notice_loss(visit, check))
            answer = await visit.ask()
        except (NetworkError, LinkError) as error:
            self._tell(CheckFailed(check, str(error)))
            return
        self._tell(CheckAnswered(check, answer.running, answer.peers))
        if answer.running:
            await visit.keep_lease()

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


async def _stop(task: asyncio.Task[None] | None) -> None:
    """Cancels the task and waits for its end; raises what else it ended with."""
    if task is not None:
        task.cancel()
        (ended,) = await asyncio.gather(
            task, return_exceptions=True
        )  # which is cancelled only by our own caller
        if isinstance(ended, Exception):
            raise ended
