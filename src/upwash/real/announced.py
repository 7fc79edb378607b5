"""Who calls, told to a gRPC server that does not see the caller's certificate.

A door has looked at the certificate, and says in the first line of a connection whose it was. gRPC has no place for
that: it learns it by the name to which the connection to its own unix socket is bound, which it tells as the peer's.
"""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec

from upwash.core.clients import Client
from upwash.real.streams import CHUNK_BYTES, Streams

_client: msgspec.json.Decoder[Client] = msgspec.json.Decoder(Client)
_FIRST_LINE_S = 5.0


def announcement(client: Client) -> bytes:
    """The first line of a connection."""
    return msgspec.json.encode(client) + b"\n"


async def announced(reader: asyncio.StreamReader) -> Client:
    """Whom the first line announces; raises OSError where it announces nobody."""
    try:
        async with asyncio.timeout(_FIRST_LINE_S):
            return _client.decode(await reader.readline())
    except (ValueError, msgspec.MsgspecError):
        raise ConnectionAbortedError("the first line announces nobody") from None


def _unlink(name: str) -> None:
    Path(name).unlink(missing_ok=True)


def announcing_at(path: str) -> Callable[[Client], Awaitable[Streams]]:
    """Connects to that unix socket, and announces for whom."""

    async def connect(client: Client) -> Streams:
        reader, writer = await asyncio.open_unix_connection(path, limit=CHUNK_BYTES)
        writer.write(announcement(client))
        return reader, writer

    return connect


class Inside:
    """The unix socket of a gRPC server, and who is at the other end of the connections to it."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._clients: dict[str, Client] = {}
        self._numbers = itertools.count()

    async def connect(self, client: Client) -> Streams:
        """A connection on behalf of that client."""
        name = f"{self.path}-{next(self._numbers)}"
        connection = socket.socket(socket.AF_UNIX)
        connection.setblocking(False)
        peer = f"unix:{name}"
        try:
            connection.bind(name)
            self._clients[peer] = client
            await asyncio.get_running_loop().sock_connect(connection, self.path)
            reader, writer = await asyncio.open_unix_connection(sock=connection, limit=CHUNK_BYTES)
        except BaseException:
            self._clients.pop(peer, None)
            connection.close()
            raise
        finally:
            _unlink(name)
        closed = asyncio.create_task(writer.wait_closed())
        closed.add_done_callback(lambda _: self._forget(peer, closed))
        return reader, writer

    def client(self, peer: str) -> Client:
        """Who is at the other end of gRPC's peer; nobody where it has hung up."""
        return self._clients.get(peer, Client(""))

    def _forget(self, peer: str, closed: asyncio.Task[None]) -> None:
        if not closed.cancelled():
            closed.exception()  # hung up, however
        self._clients.pop(peer, None)
