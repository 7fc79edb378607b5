"""Who calls, told to a gRPC server that does not see the caller's certificate.

A door has looked at the certificate, and says in the first line of a connection whose it was. gRPC has no place for
that: it learns it by the name to which the connection to its own unix socket is bound, which it tells as the peer's.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import msgspec

from upwash.core.admission.clients import Client
from upwash.real.link.given_sockets import take
from upwash.real.link.streams import End

Connect = Callable[[Client], AbstractAsyncContextManager[End]]  # to whoever is to hear that client

_client: msgspec.json.Decoder[Client] = msgspec.json.Decoder(Client)
_FIRST_LINE_S = 5.0
_SEND_BYTES = 2**20  # or what the system allows


def announcement(client: Client) -> bytes:
    """The first line of a connection."""
    return msgspec.json.encode(client) + b"\n"


async def announced(caller: End) -> Client:
    """Whom the first line announces; raises OSError where it announces nobody."""
    try:
        async with asyncio.timeout(_FIRST_LINE_S):
            return _client.decode(await caller.line())
    except (ValueError, msgspec.MsgspecError):
        raise ConnectionAbortedError("the first line announces nobody") from None


def announcing_at(path: str) -> Connect:
    """Announces clients at that unix socket, and is given a connection to gRPC for each."""

    @contextlib.asynccontextmanager
    async def connect(client: Client) -> AsyncIterator[End]:
        with socket.socket(socket.AF_UNIX) as asking:
            asking.setblocking(False)
            loop = asyncio.get_running_loop()
            await loop.sock_connect(asking, path)
            await loop.sock_sendall(asking, announcement(client))
            async with _end_of(await take(asking)) as end:
                yield end

    return connect


class Inside:
    """The unix socket of a gRPC server, and who is at the other end of the connections to it."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._clients: dict[str, Client] = {}
        self._numbers = itertools.count()

    @contextlib.asynccontextmanager
    async def connection(self, client: Client) -> AsyncIterator[socket.socket]:
        """A connection on behalf of that client, who is not known any more after the block."""
        name = f"{self.path}-{next(self._numbers)}"
        peer = f"unix:{name}"
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.setblocking(False)
            # Room for a photo: else who sends it has to wait in between until gRPC has read some of it.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
            try:
                connection.bind(name)
                self._clients[peer] = client
                await asyncio.get_running_loop().sock_connect(connection, self.path)
            finally:
                _unlink(name)
            yield connection
        finally:
            self._clients.pop(peer, None)
            connection.close()

    @contextlib.asynccontextmanager
    async def connect(self, client: Client) -> AsyncIterator[End]:
        """The same, as an end that can be joined."""
        async with self.connection(client) as connection, _end_of(connection) as end:
            yield end

    def client(self, peer: str) -> Client:
        """Who is at the other end of gRPC's peer; nobody where it has hung up."""
        return self._clients.get(peer, Client(""))


def _unlink(name: str) -> None:
    Path(name).unlink(missing_ok=True)


@contextlib.asynccontextmanager
async def _end_of(connection: socket.socket) -> AsyncIterator[End]:
    """The connection, which is broken off at the end of the block."""
    _, end = await asyncio.get_running_loop().create_unix_connection(End, sock=connection)
    try:
        yield end
    finally:
        end.hang_up()
