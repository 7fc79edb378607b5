"""Connections of bytes, and handing them on."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

CHUNK_BYTES = 2**18
_BACKLOG = 512

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def join(outer: Streams, inner: Streams, *, seen: Callable[[bytes], None] = lambda _: None) -> None:
    """Hands on what comes at either end to the other, until one hangs up; then both are closed.

    `seen` is shown what comes from outside before it is handed on, and ends it all by raising.
    """
    (hear_outer, tell_outer), (hear_inner, tell_inner) = outer, inner
    back = asyncio.create_task(_hand_on(hear_inner, tell_outer))
    try:
        await _hand_on(hear_outer, tell_inner, seen)
    finally:
        close(tell_inner)
        try:
            await back
        finally:
            close(tell_outer)


def close(writer: asyncio.StreamWriter) -> None:
    """Closes it unless that was done: a TLS connection that is closed twice cannot be broken off in Python 3.11.2."""
    if not writer.is_closing():
        writer.close()


def hang_up(writer: asyncio.StreamWriter) -> None:
    """Breaks the connection off at once, if there still is one."""
    with contextlib.suppress(AttributeError):  # Python 3.11.2's word for a TLS connection that has ended
        writer.transport.abort()


async def _hand_on(
    source: asyncio.StreamReader,
    target: asyncio.StreamWriter,
    seen: Callable[[bytes], None] = lambda _: None,
) -> None:
    """Copies what comes until it ends, then hangs up: gRPC never closes one half."""
    try:
        while chunk := await _next(source):
            seen(chunk)
            if not await _passed_on(chunk, target):
                break
    finally:
        close(target)


async def _next(source: asyncio.StreamReader) -> bytes:
    """What comes next; nothing where the other end has hung up, however."""
    try:
        return await source.read(CHUNK_BYTES)
    except OSError:
        return b""


async def _passed_on(chunk: bytes, target: asyncio.StreamWriter) -> bool:
    try:
        target.write(chunk)
        await target.drain()
    except OSError:
        return False
    return True


def listening_socket(address: str) -> socket.socket:
    """One that listens at `HOST:PORT` or `unix:PATH`; raises OSError."""
    if address.startswith("unix:"):
        path = Path(address.removeprefix("unix:"))
        path.unlink(missing_ok=True)  # of an instance that has ended
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(path))
        listening.listen(_BACKLOG)
        return listening
    host, _, port = address.rpartition(":")
    family, _, _, _, place = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
    is_any = family == socket.AF_INET6 and place[0] == "::"
    listening = socket.create_server(place[:2], family=family, backlog=_BACKLOG, dualstack_ipv6=is_any)
    # Inherited by each connection: asyncio does not set it on those of a socket that it did not make, and then a
    # server's second small write waits 40 ms for the acknowledgement of its first.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def endpoint_of(listening: socket.socket) -> str:
    """How drones are told to reach it: a port is enough, as they know how this machine is reached."""
    name = listening.getsockname()
    return f"unix:{name}" if isinstance(name, str) else f":{name[1]}"
