"""The way into an instance, from a socket outside to gRPC's own unix socket inside.

A socket belongs to the network that it was made in. The daemon makes the listening socket and the instance inherits
it, so callers are accepted where there is no network at all. The door names the caller in the first line of each
connection. A door on the same machine then gets a connection to gRPC from the instance; for others the bytes are
handed on. gRPC has no place for the caller's name: it learns it from the address that the connection is bound to.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from upwash.core.admission.clients import Client
from upwash.real.link.streams import StreamEnd, join, readable
from upwash.support.background import only_logged, start, thread

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

Connect = Callable[[Client], AbstractAsyncContextManager[StreamEnd]]  # to the program that serves this client

_client: msgspec.json.Decoder[Client] = msgspec.json.Decoder(Client)
_FIRST_LINE_S = 5.0
_GIVEN_S = 5.0
_CARRIER = b"\0"  # a socket travels with a byte
_SEND_BYTES = 2**20  # room for a photo, or what the system allows
_MOST_CONNECTIONS = 1024


def announcement(client: Client) -> bytes:
    """The first line of a connection, which names the client."""
    return msgspec.json.encode(client) + b"\n"


def announcing_at(path: str) -> Connect:
    """A function that announces a client at an instance's unix socket, and yields its connection to gRPC."""

    @contextlib.asynccontextmanager
    async def connect(client: Client) -> AsyncIterator[StreamEnd]:
        with socket.socket(socket.AF_UNIX) as asking:
            asking.setblocking(False)
            loop = asyncio.get_running_loop()
            await loop.sock_connect(asking, path)
            await loop.sock_sendall(asking, announcement(client))
            async with _end_of(await take(asking)) as end:
                yield end

    return connect


class GrpcSocket:
    """The unix socket of a gRPC server, and the clients at the other ends of its connections."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._clients: dict[str, Client] = {}
        self._numbers = itertools.count()

    @contextlib.asynccontextmanager
    async def connection(self, client: Client) -> AsyncIterator[socket.socket]:
        """A connection for that client, which is forgotten after the block."""
        name = f"{self.path}-{next(self._numbers)}"
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.setblocking(False)
            # Room for a photo: otherwise its sender waits until gRPC has read some of it.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
            try:
                connection.bind(name)
                self._clients[f"unix:{name}"] = client
                await asyncio.get_running_loop().sock_connect(connection, self.path)
            finally:
                Path(name).unlink(missing_ok=True)  # noqa: ASYNC240 - no disk is asked
            yield connection
        finally:
            self._clients.pop(f"unix:{name}", None)
            connection.close()

    @contextlib.asynccontextmanager
    async def connect(self, client: Client) -> AsyncIterator[StreamEnd]:
        """A connection for that client, as an end for `join`; forgotten after the block."""
        async with self.connection(client) as connection, _end_of(connection) as end:
            yield end

    def client(self, peer: str) -> Client:
        """The client at gRPC's address `peer`; an unnamed client after it hung up."""
        return self._clients.get(peer, Client(""))


@contextlib.asynccontextmanager
async def _end_of(connection: socket.socket) -> AsyncIterator[StreamEnd]:
    _, end = await asyncio.get_running_loop().create_unix_connection(StreamEnd, sock=connection)
    try:
        yield end
    finally:
        end.hang_up()


def open_proxy(
    outside: socket.socket, inside: GrpcSocket, *, is_announced: bool, context: ssl.SSLContext | None = None
) -> None:
    """Lets callers in, at most 1024 at once, in a thread of its own until the process ends.

    With `is_announced` the first line of each connection names the client.
    """
    callers: set[asyncio.Task[None]] = set()

    def enter(caller: StreamEnd) -> None:
        if len(callers) >= _MOST_CONNECTIONS:
            caller.hang_up()
            return
        task = start(_serve(caller, outside, inside, is_announced), name="a connection", failed=only_logged)
        callers.add(task)
        task.add_done_callback(callers.discard)

    async def accept() -> None:
        loop = asyncio.get_running_loop()
        listen = loop.create_unix_server if outside.family == socket.AF_UNIX else loop.create_server
        server = await listen(lambda: StreamEnd(enter), sock=outside, ssl=context)
        await server.serve_forever()

    thread(lambda: asyncio.run(accept()), name="socket proxy", failed=lambda _: os._exit(1)).start()


async def _serve(caller: StreamEnd, outside: socket.socket, inside: GrpcSocket, is_announced: bool) -> None:
    """Returns when the caller, or the door on its behalf, has hung up."""
    try:
        client = await _announced(caller) if is_announced else Client("")
        if is_announced and outside.family == socket.AF_UNIX:
            async with inside.connection(client) as connection:
                with socket.socket(fileno=os.dup(caller.transport.get_extra_info("socket").fileno())) as over:
                    socket.send_fds(over, [_CARRIER], [connection.fileno()])
                await caller.line()  # which never comes: it ends when the door hangs up
        else:
            async with inside.connect(client) as end:
                await join(caller, end)
    except OSError:
        pass  # hung up
    finally:
        caller.close()


async def _announced(caller: StreamEnd) -> Client:
    try:
        async with asyncio.timeout(_FIRST_LINE_S):
            return _client.decode(await caller.line())
    except (ValueError, msgspec.MsgspecError):
        raise ConnectionAbortedError("the first line names no client") from None


# --- connections from an instance ---------------------------------------------------------------------------


class GivenSocket(socket.socket):
    """A socket whose calls never block.

    The giving process may keep the socket and make it block, a mode that both share; so each call asks not to wait.
    """

    def recv(self, bufsize: int, flags: int = 0, /) -> bytes:
        """As `socket.recv`."""
        return super().recv(bufsize, flags | socket.MSG_DONTWAIT)

    def recv_into(self, buffer: WriteableBuffer, nbytes: int = 0, flags: int = 0) -> int:
        """As `socket.recv_into`."""
        return super().recv_into(buffer, nbytes, flags | socket.MSG_DONTWAIT)

    def send(self, data: ReadableBuffer, flags: int = 0, /) -> int:
        """As `socket.send`."""
        return super().send(data, flags | socket.MSG_DONTWAIT)

    def sendmsg(
        self, buffers: Iterable[ReadableBuffer], ancdata: Any = (), flags: int = 0, address: Any = None, /
    ) -> int:
        """As `socket.sendmsg`."""
        return super().sendmsg(buffers, ancdata, flags | socket.MSG_DONTWAIT, address)


async def take(over: socket.socket) -> GivenSocket:
    """The connection that an instance gives over that unix socket; raises OSError if it gives none in time."""
    try:
        async with asyncio.timeout(_GIVEN_S):
            await readable(over)
    except TimeoutError:
        raise ConnectionAbortedError(f"an instance gave no connection to itself in {_GIVEN_S:g} s") from None
    _, files, _, _ = socket.recv_fds(over, len(_CARRIER), 1, socket.MSG_CMSG_CLOEXEC)
    if not files:
        raise ConnectionAbortedError("an instance gave no connection to itself")
    try:
        given = GivenSocket(fileno=files[0])
    except OSError:
        os.close(files[0])
        raise ConnectionAbortedError("what an instance gave is no socket") from None
    if (given.family, given.type) != (socket.AF_UNIX, socket.SOCK_STREAM):
        given.close()
        raise ConnectionAbortedError("an instance gave a socket of another kind")
    return given
