"""Byte streams, and passing bytes between two of them."""

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
    """The buffer into which all connections of this thread read; each hands its bytes on at once."""
    if not hasattr(_rooms, "room"):
        _rooms.room = memoryview(bytearray(_ROOM_BYTES))
    found: memoryview = _rooms.room
    return found


class StreamEnd(asyncio.BufferedProtocol):
    """This end of a connection: arriving bytes are kept until it is joined to another end, then passed on there.

    `made` is called once it is connected; the future `lost` is done when the connection is over.
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
        """The first line that arrives, before `join`; raises OSError if none comes or the line is too long."""
        while b"\n" not in self._early:
            if self.lost.done() or len(self._early) > _LONGEST_LINE_BYTES:
                raise ConnectionAbortedError("it said no line")
            self._come.clear()
            await self._come.wait()
        line, _, rest = bytes(self._early).partition(b"\n")
        self._early[:] = rest
        return line

    def lead_to(self, other: StreamEnd, watch: Callable[[bytes], None] = lambda _: None) -> None:
        """Passes arriving bytes on to `other`; `watch` gets them first, and ends it all by raising OSError."""
        self._other, self._watch = other, watch
        early = bytes(self._early)
        self._early.clear()
        self.transport.resume_reading()
        if early:
            self.data_received(early)

    def close(self) -> None:
        """Closes the connection when all is sent, and only once: Python 3.11.2 cannot abort TLS after two closes."""
        if not self.transport.is_closing():
            self.transport.close()

    def hang_up(self) -> None:
        """Aborts the connection, if there still is one."""
        hang_up(self.transport)

    # --- what asyncio calls ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by the loop when it is connected."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - of a stream
        self.transport = transport
        transport.set_write_buffer_limits(_WAITING_BYTES)
        self._made(self)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """The buffer into which the loop reads."""
        return room()

    def buffer_updated(self, count: int) -> None:
        """Called by the loop when bytes were read into the buffer."""
        self.data_received(bytes(room()[:count]))

    def data_received(self, data: bytes) -> None:
        """Keeps arrived bytes, or passes them on."""
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
        """Stops reading at the other end, as this peer reads too slowly."""
        if self._other is not None:
            self._other.transport.pause_reading()

    def resume_writing(self) -> None:
        """Reads at the other end again, as this peer has read enough."""
        if self._other is not None:
            self._other.transport.resume_reading()

    def connection_lost(self, _error: Exception | None) -> None:
        """Called by the loop when the connection is over, for any reason."""
        if not self.lost.done():
            self.lost.set_result(None)
        self._come.set()


async def join(
    outer: StreamEnd, inner: StreamEnd, *, watch: Callable[[bytes], None] = lambda _: None
) -> None:
    """Passes bytes between both ends until one hangs up; then both are closed.

    `watch` gets the bytes from outside before they are passed on, and ends both by raising OSError, which is raised
    here.
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
    """Aborts the connection, if there still is one."""
    with contextlib.suppress(AttributeError):  # Python 3.11.2's word for a TLS connection that has ended
        transport.abort()


async def readable(connection: socket.socket) -> None:
    """Waits until the socket has bytes, a connection, or its end to read."""
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
    """The endpoint that drones get: `unix:PATH`, or `:PORT` alone, as they know this machine's address."""
    name = listening.getsockname()
    return f"unix:{name}" if isinstance(name, str) else f":{name[1]}"
