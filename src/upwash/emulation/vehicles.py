"""The way from a drone's namespace to its vehicle: MAVLink is carried there, and its position is followed."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import Any, TypeVar

from upwash.core.geo import LocalFrame, Position
from upwash.emulation.namespaces import enter, enter_handle
from upwash.real.mavlink import MavlinkLink, connect_autopilot

T = TypeVar("T")


@contextlib.contextmanager
def on_a_loop(
    enter: Callable[[], object], using: Callable[[], AbstractAsyncContextManager[T]]
) -> Iterator[T]:
    """Holds what `using` opens until the end of the block, on the loop of a thread that has entered a namespace.

    A loop that ends earlier has its failure raised at the end of the block.
    """
    ready: Future[Any] = Future()  # what is held, and what ends that

    async def hold() -> None:
        loop, over = asyncio.get_running_loop(), asyncio.Event()
        async with using() as held:
            ready.set_result((held, lambda: loop.call_soon_threadsafe(over.set)))
            await over.wait()

    def run() -> None:
        enter()
        asyncio.run(hold())

    with ThreadPoolExecutor(1, "namespace") as threads:
        over: Future[Any] = threads.submit(run)
        wait((ready, over), return_when=FIRST_COMPLETED)
        if not ready.done():
            over.result()
        held, end = ready.result()
        try:
            yield held
        finally:
            with contextlib.suppress(RuntimeError):  # the loop has ended by itself, and the result says why
                end()
            over.result()


@contextlib.contextmanager
def relayed(connection: str, *, namespace: str, outside: int) -> Iterator[str]:
    """Carries MAVLink to and from a vehicle until the end of the block; yields how to connect from the namespace.

    The connection is made in the network namespace whose handle `outside` is.
    """
    relay = _Relay()

    def listen_inside_and_go_out() -> None:
        enter(namespace)
        relay.listen()
        enter_handle(outside)

    with on_a_loop(listen_inside_and_go_out, lambda: relay.carrying(connection)) as address:
        yield address


class _Relay(asyncio.DatagramProtocol):
    """A socket inside the namespace, and a connection outside."""

    def __init__(self) -> None:
        self._peers: set[Any] = set()
        self._to_vehicle: Callable[[bytes], None] = lambda _: None

    def listen(self) -> None:
        """Opens the socket in the namespace that the thread is in."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))

    @contextlib.asynccontextmanager
    async def carrying(self, connection: str) -> AsyncIterator[str]:
        """Connects to the vehicle and carries messages; yields the way to the socket."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=self._socket)
        vehicle = MavlinkLink(connection, self._heard)
        self._to_vehicle = vehicle.send_bytes
        host, port = self._socket.getsockname()
        try:
            yield f"udpout:{host}:{port}"
        finally:
            await vehicle.close()
            self._transport.close()

    def datagram_received(self, data: bytes, address: Any) -> None:
        self._peers.add(address)
        self._to_vehicle(data)

    def _heard(self, message: Any) -> None:
        for peer in sorted(self._peers):
            self._transport.sendto(bytes(message.get_msgbuf()), peer)


@contextlib.contextmanager
def tracked(connection: str, *, namespace: str, frame: LocalFrame) -> Iterator[Callable[[], Position]]:
    """Listens to the vehicle from inside the namespace until the end of the block; AutopilotError if it is not heard.

    Yields what tells its position, relative to home, which it says ten times a second.
    """
    with on_a_loop(partial(enter, namespace), partial(_listening, connection, frame)) as position:
        yield position


@contextlib.asynccontextmanager
async def _listening(connection: str, frame: LocalFrame) -> AsyncIterator[Callable[[], Position]]:
    autopilot = await connect_autopilot(
        connection, frame=frame, ground_speed_m_s=1.0
    )  # it is never told to fly
    try:
        yield lambda: autopilot.position
    finally:
        await autopilot.close()
