"""The one way into a sandbox: connections to a socket from outside, handed on to a unix socket inside.

A socket belongs to the network that it was made in. The daemon makes the listening one and the instance inherits it,
so that connections are accepted where there is no network at all. The bytes are handed on as they are: TLS, where
there is any, is between the caller and the instance's gRPC, which cannot take over a socket that it did not make.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading

_CHUNK_BYTES = 2**18
_MOST_CONNECTIONS = 1024  # most of whom may be strangers that say nothing, until gRPC hangs up on them


class Doorway:
    """Hands connections on in a thread of its own until the process ends; so many at once, and no more."""

    def __init__(self, outside: socket.socket, inside: str) -> None:
        self._outside = outside
        self._inside = inside
        self._connections = 0

    def open(self) -> None:
        """Begins to accept connections."""
        threading.Thread(target=asyncio.run, args=(self._serve(),), name="doorway", daemon=True).start()

    async def _serve(self) -> None:
        start = asyncio.start_unix_server if self._outside.family == socket.AF_UNIX else asyncio.start_server
        server = await start(self._connect, sock=self._outside, limit=_CHUNK_BYTES)
        await server.serve_forever()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections <= _MOST_CONNECTIONS:
                await self._connect_inside(reader, writer)
        except OSError:
            pass  # hung up
        finally:
            self._connections -= 1
            writer.close()

    async def _connect_inside(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answers, requests = await asyncio.open_unix_connection(self._inside, limit=_CHUNK_BYTES)
        back = asyncio.create_task(_hand_on(answers, writer))
        try:
            await _hand_on(reader, requests)
        finally:
            requests.close()
            with contextlib.suppress(OSError):
                await back


async def _hand_on(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
    """Copies what comes until it ends, then hangs up: gRPC never closes one half."""
    try:
        while chunk := await source.read(_CHUNK_BYTES):
            target.write(chunk)
            await target.drain()
    finally:
        target.close()
