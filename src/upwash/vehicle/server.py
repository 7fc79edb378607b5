"""The stand-in on the network: MAVLink over UDP or TCP, with as many peers as care to ask."""

from __future__ import annotations

import asyncio
from typing import Any

from upwash.errors import UsageError
from upwash.mavlink.packets import PacketReader
from upwash.mavlink.signing import SignatureRefusal, Signing
from upwash.support.background import end, start
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.firmware import ArduCopterFirmware
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection, StandIn
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.px4.firmware import Px4Firmware
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.px4.vehicle import Quadrotor

_FORGOTTEN_AFTER_S = 10.0
_MOST_UNSENT_BYTES = 65_536


def switched_on(settings: VehicleSettings | Px4Settings, signing: Signing | None = None) -> StandIn:
    """A stand-in without a socket, with the autopilot that the settings are for."""
    now_s = asyncio.get_running_loop().time()
    if isinstance(settings, Px4Settings):
        return StandIn(Px4Firmware(Quadrotor(settings, now_s=now_s)), settings.speedup, signing)
    return StandIn(ArduCopterFirmware(Copter(settings, now_s=now_s)), settings.speedup, signing)


async def serve_vehicle(
    listen: str, settings: VehicleSettings | Px4Settings, *, signing: Signing | None = None
) -> VehicleServer:
    """Switches a stand-in on at `udp:HOST:PORT` or `tcp:HOST:PORT` (0: a free port); UsageError if it cannot.

    With `signing` it signs all that it says, and obeys nothing that is not signed with the same key.
    """
    kind, host, port = _parse(listen)
    loop = asyncio.get_running_loop()
    vehicle = switched_on(settings, signing)
    one_peer = isinstance(settings, Px4Settings) and settings.one_peer
    endpoint: asyncio.BaseTransport | asyncio.Server
    try:
        if kind == "udp":
            endpoint, _ = await loop.create_datagram_endpoint(
                lambda: _Datagrams(vehicle, one_peer=one_peer), local_addr=(host, port)
            )
            place = endpoint.get_extra_info("sockname")
        else:
            endpoint = server = await loop.create_server(lambda: _Stream(vehicle), host, port)
            place = server.sockets[0].getsockname()
    except OSError as error:
        raise UsageError(
            f"the vehicle cannot listen on {listen}: {error.strerror or error}; "
            "stop the program that uses the address, or give another (port 0 takes a free one)"
        ) from error
    return VehicleServer(f"{kind}:{place[0]}:{place[1]}", vehicle, endpoint)


def _parse(listen: str) -> tuple[str, str, int]:
    kind, _, place = listen.partition(":")
    host, _, port = place.rpartition(":")
    if kind not in ("udp", "tcp") or ":" not in place or not port.isdecimal() or int(port) > 65_535:
        raise UsageError(f'the vehicle cannot listen on "{listen}"; write udp:HOST:PORT or tcp:HOST:PORT')
    return kind, "0.0.0.0" if host in ("", "*") else host, int(port)  # noqa: S104 - as the user says


class VehicleServer:
    """A stand-in that is switched on and reachable at `address`, such as `udp:127.0.0.1:14550`."""

    def __init__(
        self, address: str, vehicle: StandIn, endpoint: asyncio.BaseTransport | asyncio.Server
    ) -> None:
        self.address = address
        self._vehicle = vehicle
        self._endpoint = endpoint
        self._life = start(vehicle.live(), name="the stand-in", failed=lambda _: self._switch_off())

    def fail(self, kind: FaultKind) -> None:
        """Begins a fault."""
        self._vehicle.firmware.copter.fail(kind, self._vehicle.now_s())

    def mend(self, kind: FaultKind) -> None:
        """Ends all faults of that kind."""
        self._vehicle.firmware.copter.mend(kind)

    async def close(self) -> None:
        """Switches it off, in flight too, and frees the address."""
        await end(self._life)
        self._switch_off()
        await asyncio.sleep(0)  # transports close their sockets in the loop's next turn

    def _switch_off(self) -> None:
        self._endpoint.close()
        for connection in tuple(self._vehicle.connections):
            connection.end()


class _Datagrams(asyncio.DatagramProtocol):
    """UDP: a connection with each address that has sent MAVLink in the last 10 s.

    With one peer only, it hears everyone and answers the first, until it is switched off.
    """

    def __init__(self, vehicle: StandIn, *, one_peer: bool) -> None:
        self._vehicle = vehicle
        self._one_peer = one_peer
        self._connections: dict[Any, PeerConnection] = {}

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        # A datagram holds whole messages: read by itself, one peer's garbage cannot swallow another's message.
        for message, refusal in PacketReader(self._vehicle.signing).read(data):
            if refusal is None:
                self._connection(address).hear(message)
            elif refusal is SignatureRefusal.STALE:
                self._connection(address)  # who has the key and a clock that is behind learns the time so

    def _connection(self, address: Any) -> PeerConnection:
        if self._one_peer and self._connections:
            return next(iter(self._connections.values()))
        if address not in self._connections:
            self._forget_the_silent()
            self._connections[address] = PeerConnection(
                self._vehicle, write=lambda data: self._transport.sendto(data, address)
            )
        return self._connections[address]

    def _forget_the_silent(self) -> None:
        horizon_s = asyncio.get_running_loop().time() - _FORGOTTEN_AFTER_S
        for address, connection in tuple(self._connections.items()):
            if connection.heard_s < horizon_s:
                connection.end()
                del self._connections[address]


class _Stream(asyncio.Protocol):
    """TCP: one for each connection."""

    def __init__(self, vehicle: StandIn) -> None:
        self._vehicle = vehicle
        self._reader = PacketReader(vehicle.signing)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._transport = transport
        self._connection = PeerConnection(self._vehicle, write=self._write, hang_up=transport.abort)

    def data_received(self, data: bytes) -> None:
        for message, refusal in self._reader.read(data):
            if refusal is None:
                self._connection.hear(message)

    def connection_lost(self, error: Exception | None) -> None:
        self._connection.end()

    def _write(self, data: bytes) -> None:
        # A peer that does not read loses messages, as on a serial line, instead of filling the memory. One that has
        # hung up counts as closing before `connection_lost` is called.
        room = self._transport.get_write_buffer_size() < _MOST_UNSENT_BYTES
        if room and not self._transport.is_closing():
            self._transport.write(data)
