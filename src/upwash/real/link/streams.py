"""Connections of bytes, and handing the bytes on."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable
from pathlib import Path

from upwash.support.addresses import listening_at

_WAITING_BYTES = 2**15  # for a peer that does not read, beside what the system holds
_ROOM_BYTES = 2**16
_MOST_EARLY_BYTES = 2**15
_LONGEST_LINE_BYTES = 4096
_BACKLOG = 512

_rooms = threading.local()


def room() -> memoryview:
    """The buffer into which all connections of this thread read, one after the other: bytes are handed on at once."""
    if not hasattr(_rooms, "room"):
        _rooms.room = memoryview(bytearray(_ROOM_BYTES))
    found: memoryview = _rooms.room
    return found


class StreamEnd(asyncio.BufferedProtocol):
    """This end of a connection: bytes that arrive are kept until it is joined to another, and then handed on there.

    `made` is called once it is connected; `lost` is done when the connection is over.
    """

    transport: asyncio.Transport

    def __init__(self, made: Callable[[StreamEnd], object] = lambda _: None) -> None:
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.failure: OSError | None = None  # which `watch` raised
        self._made = made
        self._early = bytearray()
        self._come = asyncio.Event()
        self._watch: Callable[[bytes], None] = lambda _: None
        self._other: StreamEnd | None = None

    async def line(self) -> bytes:
        """The first line that arrives, before it is joined; raises OSError where none does, or a long one."""
        while b"\n" not in self._early:
            if self.lost.done() or len(self._early) > _LONGEST_LINE_BYTES:
                raise ConnectionAbortedError("it said no line")
            self._come.clear()
            await self._come.wait()
        line, _, rest = bytes(self._early).partition(b"\n")
        self._early[:] = rest
        return line

    def lead_to(self, other: StreamEnd, watch: Callable[[bytes], None] = lambda _: None) -> None:
        """Hands on there what has arrived and arrives; `watch` sees it before, and ends it by raising OSError."""
        self._other, self._watch = other, watch
        early = bytes(self._early)
        self._early.clear()
        self.transport.resume_reading()
        if early:
            self.data_received(early)

    def close(self) -> None:
        """Ends it when all is sent: once only, or a TLS connection could not be broken off in Python 3.11.2."""
        if not self.transport.is_closing():
            self.transport.close()

    def hang_up(self) -> None:
        """Breaks it off at once, if there still is one."""
        hang_up(self.transport)

    # --- what asyncio calls ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is connected."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - of a stream
        self.transport = transport
        transport.set_write_buffer_limits(_WAITING_BYTES)
        self._made(self)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """The buffer to read into."""
        return room()

    def buffer_updated(self, count: int) -> None:
        """Bytes were read into the buffer."""
        self.data_received(bytes(room()[:count]))

    def data_received(self, data: bytes) -> None:
        """Bytes have arrived."""
        if self._other is None:
            self._early += data
            if len(self._early) > _MOST_EARLY_BYTES:
                self.transport.pause_reading()
            self._come.set()
            return
        try:
            self._watch(data)
        except OSError as error:
            self.failure = error
            self.hang_up()
            return
        if not self._other.transport.is_closing():
            self._other.transport.write(data)

    def pause_writing(self) -> None:
        """The peer does not read fast enough."""
        if self._other is not None:
            self._other.transport.pause_reading()

    def resume_writing(self) -> None:
        """The peer has read enough."""
        if self._other is not None:
            self._other.transport.resume_reading()

    def connection_lost(self, _error: Exception | None) -> None:
        """It is over, for any reason."""
        if not self.lost.done():
            self.lost.set_result(None)
        self._come.set()


async def join(
    outer: StreamEnd, inner: StreamEnd, *, watch: Callable[[bytes], None] = lambda _: None
) -> None:
    """Hands on the bytes that arrive at either end to the other, until one hangs up; then both are closed.

    `watch` sees the bytes from outside before they are handed on, and ends it all by raising OSError.
    """
    outer.lead_to(inner, watch)
    inner.lead_to(outer)
    await asyncio.wait([outer.lost, inner.lost], return_when=asyncio.FIRST_COMPLETED)
    inner.hang_up()  # its answers have nowhere to go, or it has hung up itself
    outer.close()
    await asyncio.wait([outer.lost])
    if outer.failure is not None:
        raise outer.failure


def hang_up(transport: asyncio.WriteTransport) -> None:
    """Breaks the connection off at once, if there still is one."""
    with contextlib.suppress(AttributeError):  # Python 3.11.2's word for a TLS connection that has ended
        transport.abort()


async def readable(connection: socket.socket) -> None:
    """Returns when bytes, a connection or the end have arrived."""
    loop = asyncio.get_running_loop()
    come = asyncio.Event()
    loop.add_reader(connection, come.set)
    try:
        await come.wait()
    finally:
        loop.remove_reader(connection)


async def connected_pair(
    *, limit: int = _MOST_EARLY_BYTES
) -> tuple[tuple[asyncio.StreamReader, asyncio.StreamWriter], socket.socket]:
    """This program's end of a pair of sockets, and the end for another program; raises OSError."""
    own, theirs = socket.socketpair()
    try:
        return await asyncio.open_connection(sock=own, limit=limit), theirs
    except BaseException:
        own.close()
        theirs.close()
        raise


def listening_socket(address: str) -> socket.socket:
    """A socket that listens at `HOST:PORT` or `unix:PATH`; raises OSError."""
    if address.startswith("unix:"):
        path = Path(address.removeprefix("unix:"))
        path.unlink(missing_ok=True)  # of an instance that has ended
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(path))
        listening.listen(_BACKLOG)
        return listening
    listening = listening_at(address)
    # Inherited by each connection: asyncio sets it only on sockets that it made, and without it a
    # server's second small write waits 40 ms for the acknowledgement of its first.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def endpoint_of(listening: socket.socket) -> str:
    """The endpoint that drones get: a port is enough, as they know how this machine is reached."""
    name = listening.getsockname()
    return f"unix:{name}" if isinstance(name, str) else f":{name[1]}"
