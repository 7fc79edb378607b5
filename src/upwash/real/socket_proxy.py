"""The one way into an instance: connections to a socket from outside, handed on to gRPC's own unix socket inside.

A socket belongs to the network that it was made in. The daemon makes the listening one and the instance inherits it,
so that connections are accepted where there is no network at all.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading

from upwash.core.clients import Client
from upwash.real.announced import Inside, announced
from upwash.real.streams import CHUNK_BYTES, join

_MOST_CONNECTIONS = 1024


class SocketProxy:
    """Hands connections on in a thread of its own until the process ends; so many at once, and no more.

    Where a door stands outside, each begins with a line that announces who calls (`is_announced`).
    """

    def __init__(
        self,
        outside: socket.socket,
        inside: Inside,
        *,
        is_announced: bool,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self._outside = outside
        self._inside = inside
        self._is_announced = is_announced
        self._context = context
        self._connections = 0

    def open(self) -> None:
        """Begins to accept connections."""
        threading.Thread(target=asyncio.run, args=(self._serve(),), name="socket proxy", daemon=True).start()

    async def _serve(self) -> None:
        start = asyncio.start_unix_server if self._outside.family == socket.AF_UNIX else asyncio.start_server
        server = await start(self._connect, sock=self._outside, limit=CHUNK_BYTES, ssl=self._context)
        await server.serve_forever()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections <= _MOST_CONNECTIONS:
                client = await announced(reader) if self._is_announced else Client("")
                await join((reader, writer), await self._inside.connect(client))
        except OSError:
            pass  # hung up
        finally:
            self._connections -= 1
            writer.close()
