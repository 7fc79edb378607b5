"""Radio links that lose, repeat and reorder whole packets, as chance has it."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

LATE_S = 0.05


class Air:
    """Each share: of packets that are lost, that come twice, and that come late, after others."""

    def __init__(self, share: float, *, seed: int) -> None:
        self.share = share
        self._chance = random.Random(seed)

    @property
    def room(self) -> bool:
        """Whether the vehicle's side takes another packet."""
        return True

    def carry(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        if self._happens():
            return
        self._send(packet, send)
        if self._happens():
            self._send(packet, send)

    def _send(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        if self._happens():
            asyncio.get_running_loop().call_later(self._chance.uniform(0, LATE_S), send, packet)
        else:
            send(packet)

    def _happens(self) -> bool:
        return self._chance.random() < self.share


@asynccontextmanager
async def relay(vehicle: str, air: Air) -> AsyncIterator[str]:
    """The connection string that leads to the vehicle through the air."""
    kind, host, port = vehicle.split(":")
    made = _udp(host, int(port), air) if kind == "udp" else _tcp(host, int(port), air)
    async with made as connection:
        yield connection


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, vehicle: tuple[str, int], air: Air) -> None:
        self._vehicle = vehicle
        self._air = air
        self._drone: Any = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, sender: Any) -> None:
        if sender != self._vehicle:
            self._drone = sender
        target = self._drone if sender == self._vehicle else self._vehicle
        self._air.carry(data, lambda packet: self._send(packet, target))

    def _send(self, packet: bytes, target: Any) -> None:
        if not self._transport.is_closing():
            self._transport.sendto(packet, target)


@asynccontextmanager
async def _udp(host: str, port: int, air: Air) -> AsyncIterator[str]:
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Datagrams((host, port), air), local_addr=(host, 0)
    )
    try:
        yield f"udpout:{host}:{transport.get_extra_info('sockname')[1]}"
    finally:
        transport.close()


@asynccontextmanager
async def _tcp(host: str, port: int, air: Air) -> AsyncIterator[str]:
    """A bridge from TCP to a radio: the stream is whole, the packets in it are not."""

    async def bridge(from_drone: asyncio.StreamReader, to_drone: asyncio.StreamWriter) -> None:
        from_vehicle, to_vehicle = await asyncio.open_connection(host, port)
        await asyncio.gather(_carry(from_drone, to_vehicle, air), _carry(from_vehicle, to_drone, air))

    server = await asyncio.start_server(bridge, host, 0)
    try:
        yield f"tcp:{host}:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        await server.wait_closed()


async def _carry(source: asyncio.StreamReader, sink: asyncio.StreamWriter, air: Air) -> None:
    def send(packet: bytes) -> None:
        if not sink.is_closing():
            sink.write(packet)

    packets = mavlink.MAVLink(None)
    packets.robust_parsing = True
    try:
        while data := await source.read(4096):
            for message in packets.parse_buffer(data) or ():
                air.carry(bytes(message.get_msgbuf()), send)
    except ConnectionError:
        pass
    finally:
        sink.close()
