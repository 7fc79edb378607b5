"""A connection that one process makes and another uses: it is given over a unix socket between the two.

Who gives it may keep it too, and mean harm. Whether a socket blocks is a property that both share, so who is given
one asks the system each time not to wait.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from upwash.real.link.streams import readable

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

_CARRIER = b"\0"  # a socket travels with a byte
_GIVEN_S = 5.0


class GivenSocket(socket.socket):
    """A socket that never waits, whatever who gave it does to it."""

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


def give(connection: socket.socket, over: asyncio.Transport) -> None:
    """Gives a connection to whoever is at the other end of a unix socket over which nothing else is said."""
    with socket.socket(fileno=os.dup(over.get_extra_info("socket").fileno())) as carrier:
        socket.send_fds(carrier, [_CARRIER], [connection.fileno()])


async def take(over: socket.socket) -> GivenSocket:
    """The connection that is given over that unix socket; raises OSError where none is given in time."""
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
        raise ConnectionAbortedError("an instance gave something that is no socket") from None
    if (given.family, given.type) != (socket.AF_UNIX, socket.SOCK_STREAM):
        given.close()
        raise ConnectionAbortedError("an instance gave a socket of another kind")
    return given
