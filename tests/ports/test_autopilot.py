"""The driver on real sockets and a serial port: what cannot be on virtual time."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AGILE, HASTY, HOME
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import LocalFrame, Position, distance_m
from upwash.errors import (
    AutopilotError,
    UsageError,
)
from upwash.ports import Autopilot
from upwash.real.mavlink import (
    DriverPatience,
    FlightSettings,
    MavlinkAutopilot,
    MavlinkLink,
    connect_autopilot,
)
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.vehicle.server import VehicleServer, serve_vehicle

FRAME = LocalFrame(HOME)
IMPATIENT = FlightSettings(
    arm_again_s=0.2,
    progress_s=0.5,
    patience=DriverPatience(answer_s=0.2, attempts=4, others_s=0.0, quiet_after_s=0.4, lost_after_s=1.5),
)


def connection(vehicle: VehicleServer) -> str:
    return vehicle.address.replace("udp:", "udpout:")


@asynccontextmanager
async def connected(
    listen: str, settings: FlightSettings = HASTY
) -> AsyncIterator[tuple[VehicleServer, MavlinkAutopilot]]:
    vehicle = await serve_vehicle(listen, AGILE)
    try:
        autopilot = await connect_autopilot(
            connection(vehicle),
            frame=FRAME,
            ground_speed_m_s=15.0,  # on a busy machine, reports of a faster vehicle look like jumps
            settings=settings,
        )
        try:
            yield vehicle, autopilot
        finally:
            await autopilot.close()
    finally:
        await vehicle.close()


def near(position: Position, expected: Position) -> bool:
    return distance_m(position, expected) <= 1.0


@pytest.mark.parametrize("listen", ["udp:127.0.0.1:0", "tcp:127.0.0.1:0"])
async def test_a_mission_from_take_off_to_disarming(listen: str) -> None:
    async with connected(listen) as (_, autopilot):
        pilot: Autopilot = autopilot
        await take_off(pilot)
        assert near(pilot.position, Position(0.0, 0.0, 5.0))
        for waypoint in Position(10.0, 0.0, 5.0), Position(10.0, -10.0, 7.0):
            await pilot.goto(waypoint)
            assert near(pilot.position, waypoint)
        await pilot.return_home_and_land()
        assert near(pilot.position, Position(0.0, 0.0, 0.0))
        await pilot.disarm()


@pytest.mark.parametrize("kind", ["udpout", "udpin", "tcp"])
async def test_nobody_there_names_the_connection_and_what_to_check(kind: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        there = f"{kind}:127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(AutopilotError, match="check that it is powered") as caught:
        await connect_autopilot(there, frame=FRAME, ground_speed_m_s=4.0, heartbeat_timeout_s=0.2)
    assert there in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "127.0.0.1:14550",
        "udp:127.0.0.1:14550",
        "tcp:5760",
        "tcp:host:port",
        "tcp:127.0.0.1:65536",
        "serial:/dev/ttyAMA0:921",
    ],
)
async def test_a_connection_that_cannot_be_meant_is_refused_at_once(wrong: str) -> None:
    with pytest.raises(UsageError):
        await connect_autopilot(wrong, frame=FRAME, ground_speed_m_s=4.0)


async def test_over_tcp_it_comes_back_after_the_connection_broke() -> None:
    async with connected("tcp:127.0.0.1:0", settings=IMPATIENT) as (vehicle, autopilot):
        address = vehicle.address
        await vehicle.close()
        again = await serve_vehicle(address, AGILE)
        await claim_and_arm(autopilot)
        await autopilot.takeoff(1.0)
        await again.close()


async def test_a_connection_on_which_nothing_comes_any_more_is_made_anew() -> None:
    connections: list[asyncio.StreamWriter] = []
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    async def greet_and_hang(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(writer)
        if len(connections) != 2:  # the second says nothing at all
            writer.write(bytes(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(codec)))

    server = await asyncio.start_server(greet_and_hang, "127.0.0.1", 0)
    connection = f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}"
    copter = MavlinkVehicle(
        connection, DriverPatience(answer_s=0.15, others_s=0.0, dead_after_s=1.5), [ARDUCOPTER]
    )
    await copter.found(within_s=2.0)
    await copter.link_lost()
    async with asyncio.timeout(12.0):
        await copter.link_restored()
    assert len(connections) == 3
    await copter.close()
    for writer in connections:
        writer.close()
    server.close()


async def test_udpin_answers_the_vehicle_that_speaks_first() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        reserved.bind(("127.0.0.1", 0))
        port = reserved.getsockname()[1]
    heard: asyncio.Queue[Any] = asyncio.Queue()
    link = MavlinkLink(f"udpin:127.0.0.1:{port}", heard.put_nowait)
    peer: asyncio.Queue[Any] = asyncio.Queue()
    other = MavlinkLink(f"udpout:127.0.0.1:{port}", peer.put_nowait)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)
    async with asyncio.timeout(2.0):
        await link.opened.wait()
        await other.opened.wait()
        other.send_bytes(beat.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1)))
        await heard.get()
        link.send(beat)
        assert (await peer.get()).get_type() == "HEARTBEAT"
    await link.close()
    await other.close()


async def test_an_autopilot_that_cannot_be_flown_is_named() -> None:
    plane = mavlink.MAVLink_heartbeat_message(1, 3, 81, 4, 3, 3)
    said = bytes(plane.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1)))
    writers: list[asyncio.StreamWriter] = []

    def speak(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(said)
        writers.append(writer)

    server = await asyncio.start_server(speak, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(AutopilotError, match=r"MAV_TYPE_FIXED_WING was heard on tcp:.*only multicopters"):
        await connect_autopilot(
            f"tcp:127.0.0.1:{port}", frame=FRAME, ground_speed_m_s=4.0, heartbeat_timeout_s=0.5
        )
    for writer in writers:
        writer.close()
    server.close()
    await server.wait_closed()


async def test_a_serial_port_carries_messages_both_ways() -> None:
    vehicle, drone = os.openpty()
    os.set_blocking(vehicle, False)
    heard: asyncio.Queue[Any] = asyncio.Queue()
    link = MavlinkLink(f"serial:{os.ttyname(drone)}:57600", heard.put_nowait)
    codec = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)
    await link.opened.wait()
    os.write(vehicle, b"noise" + beat.pack(codec))
    async with asyncio.timeout(2.0):
        message = await heard.get()
    assert (message.get_srcSystem(), message.custom_mode) == (7, 4)
    link.send(beat)
    assert codec.parse_buffer(os.read(vehicle, 1000))[0].get_srcComponent() == 191
    await link.close()
    os.close(vehicle)
    os.close(drone)
