"""Links between programs in one process: a request is a coroutine of the other program."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol

from upwash.core.visitors import Visitor
from upwash.errors import DeadlineExceeded, InstanceError, Refused, Unreachable
from upwash.text import printable

Handler = Callable[[str, bytes, Visitor], Awaitable[bytes]]  # path, body, who asks → reply


class Air(Protocol):
    """What lies between the drone and a server."""

    def connected(self, server: str) -> bool:
        """Whether bytes get through now."""

    async def send(self, server: str, path: str, *, reply: bool) -> None:
        """Takes the time that a request, or a reply, of that path takes to arrive."""


@dataclass(slots=True)
class Switchboard:
    """Who answers at which address."""

    handlers: dict[str, Handler]

    def plug(self, address: str, handler: Handler) -> None:
        """From now on the handler answers at the address."""
        self.handlers[address] = handler

    def unplug(self, address: str) -> None:
        """From now on nobody answers there."""
        self.handlers.pop(address, None)


class ModelDialer:
    """Opens links through the air to whoever is plugged in at an address."""

    def __init__(self, drone: str, switchboard: Switchboard, air: Air) -> None:
        self._drone = drone
        self._switchboard = switchboard
        self._air = air

    def dial(self, address: str, *, server: str) -> ModelLink:
        """A link to the address."""
        return ModelLink(self._drone, address, server, self._switchboard, self._air)


class ModelLink:
    """One connection; out of range it is silent, as a radio is."""

    def __init__(self, drone: str, address: str, server: str, switchboard: Switchboard, air: Air) -> None:
        self._drone = drone
        self._address = address
        self._server = server
        self._switchboard = switchboard
        self._air = air
        self._requests: set[asyncio.Task[bytes]] = set()
        self._closed = False

    async def request(self, path: str, body: bytes, *, timeout_s: float) -> bytes:
        """Sends one request and returns its reply; raises LinkError."""
        if self._closed:
            raise Unreachable(f"{self._server} at {self._address}: the link is closed")
        exchange = asyncio.create_task(self._exchange(path, body))
        self._requests.add(exchange)
        try:
            async with asyncio.timeout(timeout_s):
                return await exchange
        except TimeoutError:
            raise DeadlineExceeded(
                f"{self._server} at {self._address}: no answer within {timeout_s:.1f} s"
            ) from None
        except asyncio.CancelledError:
            caller = asyncio.current_task()
            if (
                self._closed and caller is not None and not caller.cancelling()
            ):  # close() cancelled the exchange
                raise Unreachable(f"{self._server} at {self._address}: the link was closed") from None
            raise
        finally:
            exchange.cancel()
            self._requests.discard(exchange)

    async def close(self) -> None:
        """Breaks the connection off, with every request under way."""
        self._closed = True
        for exchange in self._requests:
            exchange.cancel()

    async def _exchange(self, path: str, body: bytes) -> bytes:
        await self._get_through()
        await self._air.send(self._server, path, reply=False)
        await self._get_through()
        handler = self._switchboard.handlers.get(self._address)
        if handler is None:
            raise Unreachable(f"{self._server} at {self._address}: nobody answers")
        try:
            reply = await handler(path, body, Visitor(self._drone))
        except InstanceError as error:
            raise Unreachable(f"{self._server} at {self._address}: {error}") from error
        except Refused as refusal:
            raise Refused(f"{self._server} at {self._address}: {printable(str(refusal))}") from refusal
        await self._air.send(self._server, path, reply=True)
        await self._get_through()
        return reply

    async def _get_through(self) -> None:
        if not self._air.connected(self._server):
            await asyncio.get_running_loop().create_future()  # until the caller's deadline
