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

from upwash.core.visitors import Visitor
from upwash.real.streams import CHUNK_BYTES, Streams

_visitor: msgspec.json.Decoder[Visitor] = msgspec.json.Decoder(Visitor)
_FIRST_LINE_S = 5.0


def announcement(visitor: Visitor) -> bytes:
    """The first line of a connection."""
    return msgspec.json.encode(visitor) + b"\n"


async def announced(reader: asyncio.StreamReader) -> Visitor:
    """Whom the first line announces; raises OSError where it announces nobody."""
    try:
        async with asyncio.timeout(_FIRST_LINE_S):
            return _visitor.decode(await reader.readline())
    except (ValueError, msgspec.MsgspecError):
        raise ConnectionAbortedError("the first line announces nobody") from None


def _unlink(name: str) -> None:
    Path(name).unlink(missing_ok=True)


def announcing_at(path: str) -> Callable[[Visitor], Awaitable[Streams]]:
    """Connects to that unix socket, and announces for whom."""

    async def connect(visitor: Visitor) -> Streams:
        reader, writer = await asyncio.open_unix_connection(path, limit=CHUNK_BYTES)
        writer.write(announcement(visitor))
        return reader, writer

    return connect


class Inside:
    """The unix socket of a gRPC server, and who is at the other end of the connections to it."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._visitors: dict[str, Visitor] = {}
        self._numbers = itertools.count()

    async def connect(self, visitor: Visitor) -> Streams:
        """A connection on behalf of that visitor."""
        name = f"{self.path}-{next(self._numbers)}"
        connection = socket.socket(socket.AF_UNIX)
        connection.setblocking(False)
        peer = f"unix:{name}"
        try:
            connection.bind(name)
            self._visitors[peer] = visitor
            await asyncio.get_running_loop().sock_connect(connection, self.path)
            reader, writer = await asyncio.open_unix_connection(sock=connection, limit=CHUNK_BYTES)
        except BaseException:
            self._visitors.pop(peer, None)
            connection.close()
            raise
        finally:
            _unlink(name)
        closed = asyncio.create_task(writer.wait_closed())
        closed.add_done_callback(lambda _: self._forget(peer, closed))
        return reader, writer

    def visitor(self, peer: str) -> Visitor:
        """Who is at the other end of gRPC's peer; nobody where it has hung up."""
        return self._visitors.get(peer, Visitor(""))

    def _forget(self, peer: str, closed: asyncio.Task[None]) -> None:
        if not closed.cancelled():
            closed.exception()  # hung up, however
        self._visitors.pop(peer, None)
