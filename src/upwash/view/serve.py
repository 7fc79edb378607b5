"""Runs the page's server until it is told to stop."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from upwash.errors import UsageError
from upwash.eventlog.results import RunResult
from upwash.real.host.signals import stopping_politely
from upwash.report.photos import PhotoShelf
from upwash.support.addresses import listening_at
from upwash.support.background import beside
from upwash.support.http import HttpServer
from upwash.view.app import application, headers_of_answers
from upwash.view.desk import new_reviewing
from upwash.view.feed import Feed
from upwash.view.recording import reading
from upwash.view.tiles import BaseMap

_GOODBYE_S = 2


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
        headers = headers_of_answers(images=beneath.tiles.sources if beneath else ())
        server = HttpServer(application(feed, shelf, beneath), headers=headers, goodbye_s=_GOODBYE_S)

        async def follow() -> None:
            await feed.follow()
            server.should_exit = True

        with stopping_politely(lambda _: feed.close()):
            ready(f"http://127.0.0.1:{listener.getsockname()[1]}/")
            async with beside(follow(), name="the reader of the logs"):
                await server.serve(sockets=[listener])


def _listening(port: int) -> socket.socket:
    try:
        return listening_at(f"127.0.0.1:{port}")
    except OSError as error:
        raise UsageError(
            f"cannot serve on port {port}: {error.strerror}; give another, or 0 for any that is free"
        ) from error
