"""The stand-in on the network, spoken to in raw bytes."""

from __future__ import annotations

import asyncio
import math
import random
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.server import VehicleServer, serve_vehicle

SETTINGS = VehicleSettings(home=GeoPosition(39.3666, 22.9507), armable_after_s=0.0)


class Client(asyncio.DatagramProtocol):
    """Says what it likes to the vehicle and remembers every message that comes back."""

    def __init__(self) -> None:
        self.heard: list[Any] = []
        self.codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self.transport = transport

    def datagram_received(self, data: bytes, _sender: Any) -> None:
        self.heard += self.codec.parse_buffer(data) or ()

    def say(self, message: Any) -> None:
        self.transport.sendto(bytes(message.pack(self.codec)))

    async def answer(self, kind: str) -> Any:
        """The next message of the kind."""
        async with asyncio.timeout(2.0):
            while True:
                for message in self.heard:
                    if message.get_type() == kind:
                        self.heard.remove(message)
                        return message
                await asyncio.sleep(0.005)

    async def command(self, number: int, *parameters: float) -> int:
        """The vehicle's result."""
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.say(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))
        ack = await self.answer("COMMAND_ACK")
        assert (ack.command, ack.target_system, ack.target_component) == (number, 255, 190)
        return int(ack.result)


@asynccontextmanager
async def client_of(vehicle: VehicleServer) -> AsyncIterator[Client]:
    _, host, port = vehicle.address.split(":")
    transport, client = await asyncio.get_running_loop().create_datagram_endpoint(
        Client, remote_addr=(host, int(port))
    )
    try:
        yield client
    finally:
        transport.close()
        await asyncio.sleep(0)


@asynccontextmanager
async def vehicle_and_client() -> AsyncIterator[tuple[VehicleServer, Client]]:
    vehicle = await serve_vehicle("udp:127.0.0.1:0", SETTINGS)
    try:
        async with client_of(vehicle) as client:
            client.say(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            yield vehicle, client
    finally:
        await vehicle.close()


async def test_nothing_but_heartbeats_until_asked() -> None:
    async with vehicle_and_client() as (_, client):
        first = await client.answer("HEARTBEAT")
        assert (first.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED, first.custom_mode) == (0, 0)
        await client.answer("HEARTBEAT")
        assert {message.get_type() for message in client.heard} <= {
            "STATUSTEXT",
            "GPS_GLOBAL_ORIGIN",
            "HOME_POSITION",
        }
        wanted = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        assert await client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, 20_000) == 0
        client.heard.clear()
        await asyncio.sleep(0.4)
        assert 10 <= len([m for m in client.heard if m.get_msgId() == wanted]) <= 21
        assert await client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, -1) == 0
        client.heard.clear()
        await asyncio.sleep(0.1)
        assert not [m for m in client.heard if m.get_msgId() == wanted]


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (mavlink.MAV_CMD_DO_PARACHUTE, (), 3),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, 20.0), 4),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, math.nan), 4),
        (mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, 0.0), 2),
        (mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, math.inf), 2),
        (mavlink.MAV_CMD_DO_SET_MODE, (1, math.nan), 4),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (math.nan,), 3),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (math.nan, 1e5), 4),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (33, math.nan), 0),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (math.inf,), 4),
    ],
)
async def test_commands_that_cannot_be_obeyed_are_answered(
    *, number: int, parameters: tuple[float, ...], result: int
) -> None:
    async with vehicle_and_client() as (_, client):
        assert await client.command(number, *parameters) == result


async def test_what_is_meant_for_another_vehicle_is_not_obeyed() -> None:
    async with vehicle_and_client() as (_, client):
        client.say(mavlink.MAVLink_command_long_message(2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        assert await client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 0) == 0
        while beat := await client.answer("HEARTBEAT"):
            if not client.heard:
                break
        assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


async def test_garbage_does_not_stop_it() -> None:
    chance = random.Random(1)
    async with vehicle_and_client() as (vehicle, client), client_of(vehicle) as vandal:
        whole = bytes(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(client.codec))
        for length in range(1, 300):
            vandal.transport.sendto(b"\xfd" + chance.randbytes(length))
            client.transport.sendto(chance.randbytes(length) + whole[: length % len(whole)])
            await asyncio.sleep(0)  # the vehicle reads as fast as it is written to
        assert await client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 245) == 0
        assert not vandal.heard


@pytest.mark.parametrize(("kind", "socket_type"), [("udp", socket.SOCK_DGRAM), ("tcp", socket.SOCK_STREAM)])
async def test_an_address_in_use_is_named_with_the_remedy(kind: str, socket_type: int) -> None:
    with socket.socket(socket.AF_INET, socket_type) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == "tcp":
            taken.listen()
        address = f"{kind}:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UsageError, match="port 0") as caught:
            await serve_vehicle(address, SETTINGS)
    assert address in str(caught.value)


@pytest.mark.parametrize(
    "listen", ["", "127.0.0.1:14550", "udpin:127.0.0.1:0", "tcp:127.0.0.1", "udp:h:99999"]
)
async def test_an_address_that_cannot_be_meant_is_refused(listen: str) -> None:
    with pytest.raises(UsageError, match="udp:HOST:PORT or tcp:HOST:PORT"):
        await serve_vehicle(listen, SETTINGS)


async def test_closing_frees_the_address() -> None:
    for kind in "udp", "tcp":
        vehicle = await serve_vehicle(f"{kind}:127.0.0.1:0", SETTINGS)
        await vehicle.close()
        again = await serve_vehicle(vehicle.address, SETTINGS)
        await again.close()
