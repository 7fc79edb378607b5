"""Links between programs of one process, and the end of a drone's computer."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import TypeAlias

from upwash.core.admission.clients import Client
from upwash.errors import (
    DeadlineExceeded,
    InstanceError,
    NoLease,
    NotBegun,
    Refused,
    Unreachable,
    UpwashError,
)
from upwash.rpc.service import Reduced, may_queue
from upwash.support.background import begin
from upwash.support.text import printable

Handler = Callable[[str, bytes, Client], Awaitable[bytes]]  # path, body, who asks → reply
Observe: TypeAlias = Callable[..., None]  # the name of an event, and its facts by keyword


def unobserved(_event: str, **_facts: object) -> None:
    """No observer."""


class Wire:
    """The path between programs of one computer: no delay."""

    def connected(self, server: str) -> bool:
        """Whether bytes reach the server now."""
        return True

    async def send(self, server: str, path: str, *, reply: bool, less: bool = False) -> None:
        """Wait for the transfer time of a request, or a reply, of that path; of a request that was made smaller."""


@dataclass(slots=True)
class Switchboard:
    """The handler of each address."""

    handlers: dict[str, Handler]

    def plug(self, address: str, handler: Handler) -> None:
        """Let the handler answer at the address."""
        self.handlers[address] = handler

    def unplug(self, address: str) -> None:
        """Remove the handler of the address."""
        self.handlers.pop(address, None)


class Life:
    """Whether one drone's computer still runs."""

    def __init__(self) -> None:
        self.is_over = False


@dataclass(frozen=True, slots=True)
class ModelDialer:
    """Opens links through the air to the handler of an address.

    `observe` gets each link that is opened ("dialled"), and each request ("sent").
    """

    drone: str
    switchboard: Switchboard
    air: Wire = field(default_factory=Wire)
    life: Life = field(default_factory=Life)
    observe: Observe = unobserved

    def dial(self, address: str, *, server: str) -> ModelLink:
        """A link to the address."""
        self.observe("dialled", server=server, address=address)
        return ModelLink(self, address, server)


class ModelLink:
    """One connection; it is silent out of range, and for good after the end of the drone's life."""

    is_far = False

    def __init__(self, dialer: ModelDialer, address: str, server: str) -> None:
        self._dialer = dialer
        self._address = address
        self._server = server
        self._requests: set[asyncio.Task[bytes]] = set()
        self._received: set[asyncio.Task[bytes]] = set()  # those that a server works at
        self._closed = False

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        """Sends one request and returns its reply; raises LinkError."""
        self._dialer.observe("sent", server=self._server, path=path)
        if self._closed:
            raise Unreachable(f"{self._server} at {self._address}: the link is closed")
        sent = body if may_queue_s is None else may_queue(body, may_queue_s)
        exchange = begin(self._exchange(path, sent))
        self._requests.add(exchange)
        try:
            await asyncio.wait((exchange,), timeout=timeout_s)
            if not exchange.done():
                raise DeadlineExceeded(
                    f"{self._server} at {self._address}: no answer within {timeout_s:.1f} s"
                )
            if exchange.cancelled():
                raise Unreachable(f"{self._server} at {self._address}: the link was closed")
            return exchange.result()
        finally:
            self._give_up(exchange)
            self._requests.discard(exchange)

    async def close(self) -> None:
        """Closes the connection at once; every request under way fails."""
        self._closed = True
        for exchange in self._requests:
            self._give_up(exchange)

    def _give_up(self, exchange: asyncio.Task[bytes]) -> None:
        """End the request; after a drone has vanished, a server still finishes what it has received."""
        if not (self._dialer.life.is_over and exchange in self._received):
            exchange.cancel()

    async def _exchange(self, path: str, body: bytes) -> bytes:
        await self._get_through()
        await self._dialer.air.send(self._server, path, reply=False, less=isinstance(body, Reduced))
        await self._get_through()
        handler = self._dialer.switchboard.handlers.get(self._address)
        if handler is None:
            raise Unreachable(f"{self._server} at {self._address} does not answer")
        try:
            reply = await self._handled(handler, path, body)
        except InstanceError as error:
            raise Unreachable(f"{self._server} at {self._address}: {error}") from error
        except NotBegun as told:
            raise NotBegun(told.queue_s, f"{self._server} at {self._address}") from told
        except Refused as refusal:
            known = NoLease if isinstance(refusal, NoLease) else Refused
            raise known(f"{self._server} at {self._address}: {printable(str(refusal))}") from refusal
        if self._dialer.life.is_over:
            return reply  # to nobody
        await self._dialer.air.send(self._server, path, reply=True)
        await self._get_through()
        return reply

    async def _handled(self, handler: Handler, path: str, body: bytes) -> bytes:
        exchange = asyncio.current_task()
        assert exchange is not None  # noqa: S101 - a coroutine runs in a task
        self._received.add(exchange)
        try:
            return await handler(path, body, Client(self._dialer.drone))
        finally:
            self._received.discard(exchange)

    async def _get_through(self) -> None:
        if self._dialer.life.is_over or not self._dialer.air.connected(self._server):
            await asyncio.get_running_loop().create_future()  # until the caller's deadline


async def lived(program: Coroutine[object, object, None], life: Life, *, until_s: float | None) -> None:
    """Run the drone's program to its end, or until `until_s`, the end of its life; raises the program's error.

    A program that is cancelled at the end of its life reaches no other program while it ends.
    """
    if until_s is None:
        await program
        return
    here = asyncio.current_task()
    assert here is not None  # noqa: S101 - a coroutine runs in a task

    def end() -> None:
        life.is_over = True
        here.cancel()

    ending = asyncio.get_running_loop().call_at(until_s, end)
    try:
        await program
    except (UpwashError, asyncio.CancelledError):
        if not life.is_over:
            raise
        here.uncancel()
    finally:
        ending.cancel()
