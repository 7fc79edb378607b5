"""The way from a drone's namespace to a vehicle outside: MAVLink is carried over, and nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

from upwash.emulation.namespaces import enter, enter_handle
from upwash.emulation.threads import on_a_loop
from upwash.real.mavlink import MavlinkLink


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
    """A socket inside, for whoever speaks to it, and a connection outside."""

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
