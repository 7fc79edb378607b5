"""Doors for tests: what certificates are shown at, in front of runtimes and listeners."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from upwash.real.instances.runtime import ProcessRuntime, sockets_in
from upwash.real.link.door import Door, Lead, leading, opened_door
from upwash.real.link.limits import DoorLimits
from upwash.real.link.listener import Listener, WhoIs, cannot_listen
from upwash.real.link.proxy import GrpcSocket
from upwash.real.link.streams import listening_socket
from upwash.real.trust.credentials import Credentials, Trust

T = TypeVar("T")
MakeListener = Callable[[str, WhoIs], Listener]


@asynccontextmanager
async def led(shown: Credentials) -> AsyncIterator[Lead]:
    """A way in on loopback."""
    async with opened_door(Trust(shown)) as door:
        yield leading(door, "127.0.0.1")


@asynccontextmanager
async def certified_processes(shown: Credentials, *, max_message_bytes: int) -> AsyncIterator[ProcessRuntime]:
    """A runtime of processes that are reached through a door on loopback."""
    with tempfile.TemporaryDirectory() as folder:
        async with led(shown) as lead:
            yield ProcessRuntime(sockets_in(Path(folder)), lead=lead, max_message_bytes=max_message_bytes)


def reached(endpoint: str) -> str:
    """Where an endpoint is for who is on this machine."""
    return f"127.0.0.1{endpoint}" if endpoint.startswith(":") else endpoint


def elsewhere(work: Coroutine[Any, Any, T]) -> T:
    """What the work returns, from a loop of its own, also while one runs in this thread."""
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(asyncio.run, work).result()


@contextmanager
def behind_door(
    make: MakeListener,
    shown: Credentials,
    *,
    listen: str = "127.0.0.1:0",
    limits: DoorLimits | None = None,
) -> Iterator[tuple[Listener, Door, str]]:
    """A listener that serves behind a door, the door, and its address."""
    try:
        outside = listening_socket(listen)
    except OSError:
        raise cannot_listen(listen) from None
    with tempfile.TemporaryDirectory() as folder:
        inside = GrpcSocket(f"{folder}/inside.sock")
        listener = make(f"unix:{inside.path}", inside.client)
        door = Door(Trust(shown), limits)
        listener.start()
        entrance = elsewhere(door.lead(outside, inside.connect))
        try:
            yield listener, door, entrance.address
        finally:
            elsewhere(door.close())
            listener.stop()
