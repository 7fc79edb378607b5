"""Runs the page's server until it is told to stop."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from upwash.errors import UsageError
from upwash.eventlog.results import RunResult
from upwash.real.host.signals import stopping_politely
from upwash.report.photos import PhotoShelf
from upwash.support.background import beside
from upwash.view.app import application
from upwash.view.desk import new_reviewing
from upwash.view.feed import Feed
from upwash.view.recording import reading
from upwash.view.tiles import BaseMap

_CONNECTIONS = 64
_GOODBYE_S = 2
_REQUEST_S = 5.0


class _Impatient(H11Protocol):
    """Closes a connection that asks nothing, and the oldest one of more than 64; a page's browser connects again.

    A limit that turned new connections away would let any program on this machine lock the pilot's browser out.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Gives it some time from now on."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self.loop.call_later(_REQUEST_S, self._hang_up)
        opened = [
            each
            for each in self.connections
            if isinstance(each, _Impatient) and not each.transport.is_closing()
        ]
        if len(opened) > _CONNECTIONS:
            min(opened, key=lambda each: each._since_s).transport.abort()

    def _hang_up(self) -> None:
        if self.cycle is None:
            self.transport.close()


class _Server(uvicorn.Server):
    """Leaves signals to the program."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


async def serve_view(
    logs: Sequence[Path],
    *,
    port: int,
    photos: Path | None,
    beneath: BaseMap | None = None,
    flown: Mapping[str, RunResult] | None = None,
    ready: Callable[[str], None],
) -> None:
    """Serves a page about the logs on this machine's loopback until SIGTERM or Ctrl-C.

    `ready` is called with the address. Port 0 is any that is free. `flown` is what other policies did, by name, in
    the world of the one log; `beneath` is the map. Raises UsageError for what is no event log.
    """
    shelf = PhotoShelf(photos)
    with reading(logs, shelf.keeps) as recordings, _listening(port) as listener:
        feed = Feed(recordings, beneath.tiles if beneath else None, flown, reviewing=new_reviewing())
        server = _Server(
            uvicorn.Config(
                application(feed, shelf, beneath),
                http=_Impatient,
                ws="none",
                lifespan="off",
                log_level="warning",
                access_log=False,
                proxy_headers=False,  # any program can send them
                server_header=False,
                timeout_graceful_shutdown=_GOODBYE_S,
            )
        )

        async def follow() -> None:
            await feed.follow()
            server.handle_exit(signal.SIGTERM, None)

        with stopping_politely(lambda _: feed.close()):
            ready(f"http://127.0.0.1:{listener.getsockname()[1]}/")
            async with beside(follow(), name="the reader of the logs"):
                await server.serve(sockets=[listener])


@contextlib.contextmanager
def _listening(port: int) -> Generator[socket.socket, None, None]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", port))
        except OSError as error:
            raise UsageError(
                f"cannot serve on port {port}: {error.strerror}; give another, or 0 for any that is free"
            ) from error
        listener.listen()
        yield listener
