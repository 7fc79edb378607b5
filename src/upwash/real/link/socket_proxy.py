"""The one way into an instance: from a socket outside to gRPC's own unix socket inside.

A socket belongs to the network that it was made in. The daemon makes the listening one and the instance inherits it,
so that connections are accepted where there is no network at all. A door on the same machine is given a connection to
gRPC for each caller that it announces; of all others the bytes are handed on.
"""

from __future__ import annotations

import asyncio
import os
import socket
import ssl

from upwash.core.admission.clients import Client
from upwash.real.link.announced import Inside, announced
from upwash.real.link.given_sockets import give
from upwash.real.link.streams import End, join
from upwash.support.background import only_logged, start, thread

_MOST_CONNECTIONS = 1024


class SocketProxy:
    """Lets callers in, in a thread of its own, until the process ends; so many at once, and no more.

    Where a door stands outside, each connection begins with a line that announces who calls (`is_announced`).
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
        self._callers: set[asyncio.Task[None]] = set()

    def open(self) -> None:
        """Begins to accept connections."""
        thread(lambda: asyncio.run(self._serve()), name="socket proxy", failed=lambda _: os._exit(1)).start()

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        listen = loop.create_unix_server if self._outside.family == socket.AF_UNIX else loop.create_server
        server = await listen(lambda: End(self._enter), sock=self._outside, ssl=self._context)
        await server.serve_forever()

    def _enter(self, caller: End) -> None:
        if len(self._callers) >= _MOST_CONNECTIONS:
            caller.hang_up()
            return
        task = start(self._serve_caller(caller), name="a caller's connection", failed=only_logged)
        self._callers.add(task)
        task.add_done_callback(self._callers.discard)

    async def _serve_caller(self, caller: End) -> None:
        try:
            await self._let_in(caller)
        except OSError:
            pass  # hung up
        finally:
            caller.close()

    async def _let_in(self, caller: End) -> None:
        """Returns when the caller, or the door on its behalf, has hung up."""
        client = await announced(caller) if self._is_announced else Client("")
        if self._is_announced and self._outside.family == socket.AF_UNIX:
            async with self._inside.connection(client) as connection:
                give(connection, over=caller.transport)
                await caller.line()  # which never comes: it ends when the door hangs up
        else:
            async with self._inside.connect(client) as inside:
                await join(caller, inside)
