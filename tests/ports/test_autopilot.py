"""The driver of the autopilot, against the stand-in vehicle and on real sockets."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import Circle, GeoPosition, LocalFrame, Position, distance_m
from upwash.errors import (
    AutopilotError,
    AutopilotLost,
    AutopilotOverruled,
    AutopilotRefused,
    AutopilotTimeout,
    UsageError,
)
from upwash.eventlog.schema import ArmingDelayed
from upwash.ports import Autopilot, VehicleNews
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, MavlinkLink, Patience, connect_autopilot
from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.copter import CommandAnswer, Copter
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.firmware import Result
from upwash.vehicle.server import VehicleServer, serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)
FRAME = LocalFrame(HOME)
AGILE = VehicleSettings(
    home=HOME,
    acceleration_m_s2=300.0,
    climb_m_s=100.0,
    descent_m_s=100.0,
    return_speed_m_s=100.0,
    return_altitude_m=0.0,
    armable_after_s=0.0,
)
HASTY = FlightSettings(arm_again_s=0.2, progress_s=0.5, patience=Patience(others_s=0.0))
IMPATIENT = FlightSettings(
    arm_again_s=0.2,
    progress_s=0.5,
    patience=Patience(answer_s=0.2, attempts=4, others_s=0.0, quiet_after_s=0.4, lost_after_s=1.5),
)

SHORT_OF_HEARING = FlightSettings(
    progress_s=0.5,
    patience=Patience(answer_s=0.1, attempts=4, others_s=0.0, quiet_after_s=0.3, lost_after_s=1.0),
)


def connection(vehicle: VehicleServer) -> str:
    return vehicle.address.replace("udp:", "udpout:")


@asynccontextmanager
async def connected(
    listen: str = "udp:127.0.0.1:0",
    vehicle_settings: VehicleSettings = AGILE,
    settings: FlightSettings = HASTY,
    ground_speed_m_s: float = 60.0,
) -> AsyncIterator[tuple[VehicleServer, MavlinkAutopilot]]:
    vehicle = await serve_vehicle(listen, vehicle_settings)
    try:
        autopilot = await connect_autopilot(
            connection(vehicle), frame=FRAME, ground_speed_m_s=ground_speed_m_s, settings=settings
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
def test_a_mission_from_take_off_to_disarming(listen: str) -> None:
    async def mission() -> None:
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

    asyncio.run(mission())


def test_the_ground_speed_holds_from_the_first_leg_on() -> None:
    async def mission() -> None:
        clock = asyncio.get_running_loop().time
        async with connected(ground_speed_m_s=30.0) as (_, autopilot):
            await take_off(autopilot)
            begun_s = clock()
            await autopilot.goto(Position(12.0, 0.0, 5.0))
            assert clock() - begun_s < 1.8  # at the speed that the vehicle has by itself: 2.4 s
            await autopilot.set_ground_speed(10.0)
            begun_s = clock()
            await autopilot.goto(Position(0.0, 0.0, 5.0))
            assert 1.0 < clock() - begun_s < 2.2

    asyncio.run(mission())


def test_hold_stops_on_the_way_and_disarming_is_refused_until_it_has_landed() -> None:
    async def mission() -> None:
        async with connected(ground_speed_m_s=10.0) as (_, autopilot):
            await take_off(autopilot, 3.0)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.4):
                    await autopilot.goto(Position(500.0, 0.0, 3.0))
            await autopilot.hold()
            stopped = autopilot.position
            assert 0 < stopped.east_m < 50
            with pytest.raises(AutopilotRefused, match=r"disarm: .*MAV_RESULT_FAILED"):
                await autopilot.disarm()
            assert near(autopilot.position, stopped)
            await autopilot.land()
            assert near(autopilot.position, Position(stopped.east_m, stopped.north_m, 0.0))
            await autopilot.disarm()

    asyncio.run(mission())


def test_it_waits_until_the_vehicle_can_be_armed() -> None:
    async def mission() -> None:
        settings = VehicleSettings(home=HOME, armable_after_s=0.5)
        async with connected(vehicle_settings=settings) as (_, autopilot):
            await claim_and_arm(autopilot)
            await autopilot.disarm()

    asyncio.run(mission())


def test_a_refusal_to_arm_says_the_vehicles_reason() -> None:
    async def mission() -> None:
        never = VehicleSettings(home=HOME, armable_after_s=1e9)
        patience = FlightSettings(arm_again_s=0.1, ready_timeout_s=0.15)
        async with connected(vehicle_settings=never, settings=patience) as (_, autopilot):
            with pytest.raises(AutopilotRefused) as caught:
                await claim_and_arm(autopilot)
        assert caught.value.step == "arm"
        assert "System not initialised" in caught.value.vehicle_said

    asyncio.run(mission())


def test_what_its_last_checks_object_to_is_told_and_it_is_armed_once_they_pass(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refusals = 2
    arms = Copter.arm

    def reluctantly(self: Copter, now_s: float, *, forced: bool = False) -> CommandAnswer:
        nonlocal refusals
        if refusals == 0:
            return arms(self, now_s, forced=forced)
        refusals -= 1
        return CommandAnswer(Result.FAILED, (Text("Arm: Throttle is not low", severity=2),))

    monkeypatch.setattr(Copter, "arm", reluctantly)

    async def mission() -> None:
        async with connected() as (_, autopilot):
            news: list[VehicleNews] = []
            autopilot.listen(news.append)
            await claim_and_arm(autopilot)
            assert news.count(ArmingDelayed(reasons=("Throttle is not low",))) == 1
            assert autopilot.armed

    asyncio.run(mission())


def test_a_flight_that_takes_too_long_is_given_up() -> None:
    async def mission() -> None:
        soon = FlightSettings(margin_s=0.5, slowest_vertical_m_s=1e6)
        slow = VehicleSettings(home=HOME, armable_after_s=0.0, climb_m_s=0.1)
        async with connected(vehicle_settings=slow, settings=soon) as (_, autopilot):
            await claim_and_arm(autopilot)
            with pytest.raises(AutopilotTimeout, match=r"takeoff to 20 m: .*GUIDED"):
                await autopilot.takeoff(20.0)

    asyncio.run(mission())


def test_when_the_pilot_takes_over_the_leg_ends_and_the_vehicle_is_left_to_the_pilot() -> None:
    async def mission() -> None:
        async with connected(ground_speed_m_s=10.0) as (vehicle, autopilot):
            await take_off(autopilot, 3.0)
            pilot = MavlinkLink(connection(vehicle), lambda _: None)
            leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 3.0)))
            await asyncio.sleep(0.2)
            pilot.send(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_LOITER))
            with pytest.raises(AutopilotOverruled, match=r"goto .*the pilot has the vehicle.*LOITER"):
                await leg
            pilot.send(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_GUIDED))
            here = Position(0.0, 0.0, 3.0)
            verbs: tuple[Callable[[], Awaitable[None]], ...] = (
                lambda: autopilot.goto(here),
                autopilot.hold,
                autopilot.land,
                autopilot.return_home_and_land,
                autopilot.disarm,
                lambda: autopilot.claim(resumes=True),
            )
            for verb in verbs:
                with pytest.raises(AutopilotOverruled, match="nothing was sent"):
                    await verb()
            await pilot.close()

    asyncio.run(mission())


def test_no_command_goes_out_on_a_report_from_before_the_pilot_took_over() -> None:
    async def mission() -> None:
        async with connected() as (vehicle, autopilot):
            await take_off(autopilot, 3.0)
            pilot, modes = await pilot_of(connection(vehicle))
            pilot.send(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_LOITER))
            with pytest.raises(AutopilotOverruled, match=r"the pilot has the vehicle.*nothing was sent"):
                await autopilot.return_home_and_land()
            assert await reported(modes) == mavlink.COPTER_MODE_LOITER
            await pilot.close()

    asyncio.run(mission())


def test_after_a_silence_it_asks_whose_the_vehicle_is_before_it_repeats_a_command() -> None:
    async def mission() -> None:
        async with connected_through_a_relay() as (relay, autopilot):
            await take_off(autopilot, 3.0)
            pilot, modes = await pilot_of(f"udpout:{relay.vehicle[0]}:{relay.vehicle[1]}")
            relay.broken = True
            returning = asyncio.create_task(autopilot.return_home_and_land())
            await asyncio.sleep(0.1)
            pilot.send(mavlink.MAVLink_set_mode_message(1, 1, mavlink.COPTER_MODE_LOITER))
            await asyncio.sleep(0.4)
            relay.broken = False
            with pytest.raises(AutopilotOverruled, match="the pilot has the vehicle"):
                await returning
            assert await reported(modes) == mavlink.COPTER_MODE_LOITER
            await pilot.close()

    asyncio.run(mission())


async def pilot_of(connection: str) -> tuple[MavlinkLink, list[int]]:
    """A ground station of the pilot's, and the modes that the vehicle reports to it from now on."""
    modes: list[int] = []

    def hear(message: Any) -> None:
        if message.get_type() == "HEARTBEAT":
            modes.append(message.custom_mode)

    link = MavlinkLink(connection, hear)
    await link.opened.wait()
    return link, modes


async def reported(modes: list[int]) -> int:
    """The mode that it reports next."""
    modes.clear()
    while not modes:  # noqa: ASYNC110
        await asyncio.sleep(0.05)
    return modes[-1]


def test_entering_and_leaving_a_circle_is_noticed() -> None:
    async def mission() -> None:
        circles = (
            Circle(Position(9.0, 0.0), 4.0),
            Circle(Position(0.0, 500.0), 10.0),
        )
        async with connected(ground_speed_m_s=20.0) as (_, autopilot):
            await take_off(autopilot, 3.0)
            leg = asyncio.create_task(autopilot.goto(Position(17.0, 0.0, 3.0)))
            await autopilot.border_crossed(circles)
            assert 5.0 <= autopilot.position.east_m < 10.0
            await autopilot.border_crossed(circles)
            assert 13.0 < autopilot.position.east_m <= 17.5
            await leg
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.3):
                    await autopilot.border_crossed(circles)

    asyncio.run(mission())


class Relay(asyncio.DatagramProtocol):
    """A radio link that can be broken: datagrams between one drone and one vehicle."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.broken = False
        self.vehicle = vehicle
        self._drone: Any = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self.transport = transport

    def datagram_received(self, data: bytes, sender: Any) -> None:
        from_vehicle = sender == self.vehicle
        if not from_vehicle:
            self._drone = sender
        if not self.broken:
            self.transport.sendto(data, self._drone if from_vehicle else self.vehicle)


@asynccontextmanager
async def connected_through_a_relay() -> AsyncIterator[tuple[Relay, MavlinkAutopilot]]:
    vehicle = await serve_vehicle("udp:127.0.0.1:0", AGILE)
    place = ("127.0.0.1", int(vehicle.address.rpartition(":")[2]))
    transport, relay = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: Relay(place), local_addr=("127.0.0.1", 0)
    )
    port = transport.get_extra_info("sockname")[1]
    autopilot = await connect_autopilot(
        f"udpout:127.0.0.1:{port}", frame=FRAME, ground_speed_m_s=20.0, settings=SHORT_OF_HEARING
    )
    try:
        yield relay, autopilot
    finally:
        await autopilot.close()
        transport.close()
        await vehicle.close()


def test_a_short_silence_is_survived_and_a_long_one_ends_the_verb_in_progress() -> None:
    async def mission() -> None:
        async with connected_through_a_relay() as (relay, autopilot):
            await take_off(autopilot, 3.0)
            relay.broken = True  # the target is lost
            asyncio.get_running_loop().call_later(0.8, setattr, relay, "broken", False)
            await autopilot.goto(Position(5.0, 0.0, 3.0))
            relay.broken = True
            asyncio.get_running_loop().call_later(0.8, setattr, relay, "broken", False)
            await autopilot.set_ground_speed(40.0)  # the silence is longer than all attempts
            relay.broken = True
            with pytest.raises(AutopilotLost, match=r"goto .* udpout:127\.0\.0\.1:\d+ for 1 s"):
                await autopilot.goto(Position(100.0, 0.0, 3.0))

    asyncio.run(mission())


@pytest.mark.parametrize("kind", ["udpout", "udpin", "tcp"])
def test_nobody_there_names_the_connection_and_what_to_check(kind: str) -> None:
    async def mission() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
            free.bind(("127.0.0.1", 0))
            there = f"{kind}:127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(AutopilotError, match="check that it is powered") as caught:
            await connect_autopilot(there, frame=FRAME, ground_speed_m_s=4.0, heartbeat_timeout_s=0.2)
        assert there in str(caught.value)

    asyncio.run(mission())


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
def test_a_connection_that_cannot_be_meant_is_refused_at_once(wrong: str) -> None:
    async def mission() -> None:
        with pytest.raises(UsageError):
            await connect_autopilot(wrong, frame=FRAME, ground_speed_m_s=4.0)

    asyncio.run(mission())


def test_over_tcp_it_comes_back_after_the_connection_broke() -> None:
    async def mission() -> None:
        async with connected("tcp:127.0.0.1:0", settings=IMPATIENT) as (vehicle, autopilot):
            address = vehicle.address
            await vehicle.close()
            again = await serve_vehicle(address, AGILE)
            await claim_and_arm(autopilot)
            await autopilot.takeoff(1.0)
            await again.close()

    asyncio.run(mission())


def test_udpin_answers_the_vehicle_that_speaks_first() -> None:
    async def mission() -> None:
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

    asyncio.run(mission())


def test_an_autopilot_that_cannot_be_flown_is_named() -> None:
    async def mission() -> None:
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

    asyncio.run(mission())


def test_a_serial_port_carries_messages_both_ways() -> None:
    async def mission() -> None:
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

    asyncio.run(mission())
