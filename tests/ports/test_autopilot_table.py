"""The driver against what an ArduCopter does, row by row, and over links that lose, repeat and reorder packets."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.lossy import Air, relay
from tests.ports.steps import claim_and_arm

from upwash.core.geo import GeoPosition, LocalFrame, Position, distance_m
from upwash.errors import AutopilotError, AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import ArmingDelayed, LinkLost, LinkRestored
from upwash.ports import VehicleNews
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, Patience, connect_autopilot
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.copter import FaultKind, VehicleFault
from upwash.vehicle.server import VehicleServer, serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)
SPEEDUP = 10.0
FAITHFUL = VehicleSettings(
    home=HOME,
    speedup=SPEEDUP,
    armable_after_s=3.0,
    parameters={"DISARM_DELAY": 10.0 * SPEEDUP},  # as long on the driver's clock as a real one's
)
AGILE = VehicleSettings(
    home=HOME,
    acceleration_m_s2=100.0,
    climb_m_s=50.0,
    descent_m_s=50.0,
    return_speed_m_s=50.0,
    return_altitude_m=0.0,
    armable_after_s=0.0,
)
BRISK = FlightSettings(
    arm_again_s=0.1,
    progress_s=0.4,
    patience=Patience(answer_s=0.15, effect_s=0.5, attempts=25, others_s=0.0, quiet_after_s=2.5),
)
LINKS = [
    pytest.param(listen, share, id=f"{listen[:3]} {share:.0%}")
    for listen in ("udp:127.0.0.1:0", "tcp:127.0.0.1:0")
    for share in (0.0, 0.05, 0.2)
]
Flight = Callable[[MavlinkAutopilot, VehicleServer, Air], Awaitable[None]]


@asynccontextmanager
async def vehicle_on_the_air(
    listen: str, share: float, settings: VehicleSettings
) -> AsyncIterator[tuple[VehicleServer, str, Air]]:
    air = Air(share, seed=1)
    async with AsyncExitStack() as stack:
        vehicle = await serve_vehicle(listen, settings)
        stack.push_async_callback(vehicle.close)
        yield vehicle, await stack.enter_async_context(relay(vehicle.address, air)), air


def fly(
    flight: Flight,
    *,
    listen: str = "udp:127.0.0.1:0",
    share: float = 0.0,
    vehicle_settings: VehicleSettings = AGILE,
    settings: FlightSettings = BRISK,
    ground_speed_m_s: float = 40.0,
) -> None:
    async def flown() -> None:
        async with vehicle_on_the_air(listen, share, vehicle_settings) as (vehicle, connection, air):
            autopilot = await connect_autopilot(
                connection, frame=LocalFrame(HOME), ground_speed_m_s=ground_speed_m_s, settings=settings
            )
            try:
                await flight(autopilot, vehicle, air)
            finally:
                await autopilot.close()

    asyncio.run(flown())


async def watch_speed(autopilot: MavlinkAutopilot, speeds_m_s: list[float]) -> None:
    """How fast it moves, from position to position."""
    clock, before, then_s = asyncio.get_running_loop().time, autopilot.position, 0.0
    then_s = clock()
    while True:
        await asyncio.sleep(0.1)
        here, now_s = autopilot.position, clock()
        speeds_m_s.append(distance_m(before, here) / (now_s - then_s) / SPEEDUP)
        before, then_s = here, now_s


@pytest.mark.parametrize(("listen", "share"), LINKS)
def test_a_whole_mission_arrives_everywhere_whatever_the_link_does(listen: str, share: float) -> None:
    async def mission(autopilot: MavlinkAutopilot, _vehicle: VehicleServer, _air: Air) -> None:
        await claim_and_arm(autopilot)
        await autopilot.takeoff(10.0)
        assert autopilot.position.altitude_m == pytest.approx(10.0, abs=1.0)
        speeds_m_s: list[float] = []
        watching = asyncio.create_task(watch_speed(autopilot, speeds_m_s))
        for waypoint in Position(30.0, 0.0, 10.0), Position(30.0, 30.0, 12.0):
            await autopilot.goto(waypoint)
            assert distance_m(autopilot.position, waypoint) <= 1.0
        watching.cancel()
        assert sorted(speeds_m_s)[len(speeds_m_s) // 2] < 3.5  # it was told 3 m/s, and flies 5.4 by itself
        await autopilot.return_home_and_land()
        assert distance_m(autopilot.position, Position(0.0, 0.0)) <= 1.0
        await autopilot.disarm()
        assert autopilot.battery_percent is not None
        assert 50 < autopilot.battery_percent < 100

    fly(mission, listen=listen, share=share, vehicle_settings=FAITHFUL, ground_speed_m_s=3.0)


@pytest.mark.parametrize(("listen", "share"), LINKS)
def test_what_the_vehicle_refuses_is_an_error_with_the_step(listen: str, share: float) -> None:
    async def mission(autopilot: MavlinkAutopilot, _vehicle: VehicleServer, _air: Air) -> None:
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match=r"takeoff to 5 m: .*MAV_RESULT_FAILED"):
            await autopilot.takeoff(5.0)
        await claim_and_arm(autopilot)
        await autopilot.takeoff(5.0)
        with pytest.raises(AutopilotRefused, match=r"takeoff to 9 m: .*MAV_RESULT_FAILED"):
            await autopilot.takeoff(9.0)
        with pytest.raises(AutopilotRefused, match=r"disarm: .*MAV_RESULT_FAILED"):
            await autopilot.disarm()
        await autopilot.land()
        await autopilot.disarm()

    fly(mission, listen=listen, share=share)


@pytest.mark.parametrize(
    ("command", "parameters", "result"),
    [
        (mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, 0.0), "DENIED"),
        (mavlink.MAV_CMD_DO_PARACHUTE, (), "UNSUPPORTED"),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, 5.0), "FAILED"),
        (mavlink.MAV_CMD_DO_SET_MODE, (1, 99), "FAILED"),
    ],
)
def test_every_no_is_told_by_its_name(command: int, parameters: tuple[float, ...], result: str) -> None:
    async def scenario() -> None:
        async with vehicle_on_the_air("udp:127.0.0.1:0", 0.2, AGILE) as (_, connection, _air):
            copter = MavlinkVehicle(connection, replace(BRISK.patience, dead_after_s=1.5), [ARDUCOPTER])
            await copter.found(within_s=5.0)
            copter.claim("start", resumes=False)
            with pytest.raises(AutopilotRefused, match=f"try: .*MAV_RESULT_{result}"):
                await copter.command("try", command, *parameters)
            await copter.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_arming_waits_for_the_position_estimate_and_the_reports_are_asked_for(share: float) -> None:
    slow_start = replace(AGILE, armable_after_s=3.5)

    async def mission(autopilot: MavlinkAutopilot, _vehicle: VehicleServer, _air: Air) -> None:
        clock = asyncio.get_running_loop().time
        begun_s = clock()
        await claim_and_arm(autopilot)
        assert clock() - begun_s > 1.0
        assert autopilot.battery_percent is not None
        assert autopilot.position == Position(0.0, 0.0)
        await autopilot.disarm()

    fly(mission, share=share, vehicle_settings=slow_start)


def test_a_refusal_to_arm_carries_the_vehicles_reason() -> None:
    stubborn = replace(AGILE, faults=(VehicleFault(FaultKind.ARMING),))

    async def mission(autopilot: MavlinkAutopilot, vehicle: VehicleServer, _air: Air) -> None:
        with pytest.raises(AutopilotRefused) as caught:
            await claim_and_arm(autopilot)
        assert caught.value.vehicle_said == "Hardware safety switch"
        vehicle.mend(FaultKind.ARMING)
        await claim_and_arm(autopilot)

    fly(mission, vehicle_settings=stubborn, settings=replace(BRISK, ready_timeout_s=2.0))


def test_without_gps_it_is_not_armed_and_in_flight_it_lands_by_itself() -> None:
    async def mission(autopilot: MavlinkAutopilot, vehicle: VehicleServer, _air: Air) -> None:
        vehicle.fail(FaultKind.GPS)
        with pytest.raises(AutopilotRefused, match="GPS"):
            await claim_and_arm(autopilot)
        vehicle.mend(FaultKind.GPS)
        await claim_and_arm(autopilot)
        await autopilot.takeoff(10.0)
        vehicle.fail(FaultKind.GPS)
        with pytest.raises(AutopilotRefused, match=r"goto .*LAND.*EKF Failsafe"):
            await autopilot.goto(Position(4_000.0, 0.0, 10.0))

    fly(
        mission,
        vehicle_settings=replace(FAITHFUL, armable_after_s=0.0),
        settings=replace(BRISK, ready_timeout_s=0.15),
        ground_speed_m_s=4.0,
    )


def test_a_battery_that_runs_low_shows() -> None:
    async def mission(autopilot: MavlinkAutopilot, vehicle: VehicleServer, _air: Air) -> None:
        news: list[VehicleNews] = []
        autopilot.listen(news.append)
        await claim_and_arm(autopilot)
        vehicle.fail(FaultKind.BATTERY)
        async with asyncio.timeout(3.0):
            while autopilot.battery_percent is None or autopilot.battery_percent > 10:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
            while not any("Battery 1 is low" in str(each) for each in news):  # noqa: ASYNC110
                await asyncio.sleep(0.02)

    fly(mission, vehicle_settings=replace(AGILE, parameters={"BATT_LOW_TIMER": 0}))


def test_a_lost_link_is_noticed_within_3_s_and_survived() -> None:
    async def mission(autopilot: MavlinkAutopilot, vehicle: VehicleServer, _air: Air) -> None:
        clock = asyncio.get_running_loop().time
        news: list[object] = []
        autopilot.listen(news.append)
        await claim_and_arm(autopilot)
        await autopilot.takeoff(5.0)
        leg = asyncio.create_task(autopilot.goto(Position(60.0, 0.0, 5.0)))
        vehicle.fail(FaultKind.LINK)
        begun_s = clock()
        await autopilot.vehicle.link_lost()
        assert 2.0 < clock() - begun_s < 3.0
        assert not autopilot.vehicle.linked
        vehicle.mend(FaultKind.LINK)
        await autopilot.vehicle.link_restored()
        await leg
        assert distance_m(autopilot.position, Position(60.0, 0.0, 5.0)) <= 1.0
        lost, restored = (each for each in news if isinstance(each, LinkLost | LinkRestored))
        assert isinstance(lost, LinkLost) and isinstance(restored, LinkRestored)
        assert 2.0 < lost.silent_s <= restored.silent_s

    fly(mission)


def test_a_connection_on_which_nothing_comes_any_more_is_made_anew() -> None:
    async def scenario() -> None:
        connections: list[asyncio.StreamWriter] = []
        codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

        async def greet_and_hang(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            connections.append(writer)
            if len(connections) != 2:  # the second says nothing at all
                writer.write(bytes(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(codec)))

        server = await asyncio.start_server(greet_and_hang, "127.0.0.1", 0)
        connection = f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}"
        copter = MavlinkVehicle(connection, replace(BRISK.patience, dead_after_s=1.5), [ARDUCOPTER])
        await copter.found(within_s=2.0)
        await copter.link_lost()
        async with asyncio.timeout(12.0):
            await copter.link_restored()
        assert len(connections) == 3
        await copter.close()
        for writer in connections:
            writer.close()
        server.close()

    asyncio.run(scenario())


def test_a_link_that_stays_lost_ends_the_verb() -> None:
    async def mission(autopilot: MavlinkAutopilot, vehicle: VehicleServer, _air: Air) -> None:
        await claim_and_arm(autopilot)
        vehicle.fail(FaultKind.LINK)
        with pytest.raises(AutopilotLost, match=r"takeoff to 5 m: nothing was heard"):
            await autopilot.takeoff(5.0)

    patience = replace(BRISK.patience, quiet_after_s=0.5, lost_after_s=1.5)
    fly(mission, settings=replace(BRISK, patience=patience))


def test_reports_that_stop_are_asked_for_again() -> None:
    async def scenario() -> None:
        async with vehicle_on_the_air("udp:127.0.0.1:0", 0.0, AGILE) as (_, connection, _air):
            copter = MavlinkVehicle(connection, replace(BRISK.patience, quiet_after_s=0.5), [ARDUCOPTER])
            await copter.found(within_s=5.0)
            position = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
            copter.question(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, position, -1)
            stopped_s = asyncio.get_running_loop().time() + 0.3
            assert await copter.happens("wait", lambda: copter.heard_since(position, stopped_s), within_s=3.0)
            await copter.close()

    asyncio.run(scenario())


def test_a_vehicle_that_starts_and_then_stops_half_way_is_given_up() -> None:
    async def mission(autopilot: MavlinkAutopilot, _vehicle: VehicleServer, air: Air) -> None:
        await claim_and_arm(autopilot)
        await autopilot.takeoff(5.0)
        air.share = 0.0
        with pytest.raises(AutopilotTimeout, match=r"goto .*: not done within \d+ s, in mode GUIDED"):
            await autopilot.goto(Position(9_000.0, 0.0, 5.0))

    fly(mission, settings=replace(BRISK, margin_s=1.0, slowest_share=1e6))


@pytest.mark.parametrize(("autopilot", "kind"), [(12, 1), (4, 2), (3, 1), (3, 10)])
def test_what_cannot_be_flown_is_refused(autopilot: int, kind: int) -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        beat = bytes(mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 3, 3).pack(codec))

        class Other(asyncio.DatagramProtocol):
            def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
                self.transport = transport

            def datagram_received(self, _data: bytes, sender: tuple[str, int]) -> None:
                self.transport.sendto(beat, sender)

        transport, _ = await loop.create_datagram_endpoint(Other, local_addr=("127.0.0.1", 0))
        port = transport.get_extra_info("sockname")[1]
        with pytest.raises(AutopilotError, match="only multicopters with ArduCopter or PX4"):
            await connect_autopilot(f"udpout:127.0.0.1:{port}", frame=LocalFrame(HOME), ground_speed_m_s=4.0)
        transport.close()

    asyncio.run(scenario())


class Doubtful(asyncio.DatagramProtocol):
    """Passes its checks and flies in GUIDED without knowing where it is, and takes no target."""

    def __init__(self) -> None:
        self.asked: list[int] = []  # for these reports
        self._codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self.transport = transport

    def datagram_received(self, data: bytes, sender: tuple[str, int]) -> None:
        checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        answers = [
            mavlink.MAVLink_heartbeat_message(2, 3, 81, mavlink.COPTER_MODE_GUIDED, 3, 3),
            mavlink.MAVLink_sys_status_message(checked, checked, checked, 0, 12_000, 0, 99, *[0] * 6),
            mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_CONST_POS_MODE, *[0.0] * 5),
        ]
        for message in self._codec.parse_buffer(data) or ():
            if message.get_type() == "COMMAND_INT":
                failed = mavlink.MAV_RESULT_FAILED
                answers.append(mavlink.MAVLink_command_ack_message(message.command, failed, 0, 0, 1, 191))
            elif message.get_type() == "COMMAND_LONG":
                self.asked.append(int(message.param1))
        for answer in answers:
            self.transport.sendto(answer.pack(self._codec), sender)
            self._codec.seq = (self._codec.seq + 1) % 256


@asynccontextmanager
async def doubtful_vehicle() -> AsyncIterator[tuple[Doubtful, MavlinkAutopilot]]:
    transport, vehicle = await asyncio.get_running_loop().create_datagram_endpoint(
        Doubtful, local_addr=("127.0.0.1", 0)
    )
    autopilot = await connect_autopilot(
        f"udpout:127.0.0.1:{transport.get_extra_info('sockname')[1]}",
        frame=LocalFrame(HOME),
        ground_speed_m_s=4.0,
        settings=replace(BRISK, ready_timeout_s=0.3, ask_again_s=0.1),
    )
    try:
        yield vehicle, autopilot
    finally:
        await autopilot.close()
        transport.close()


def test_a_vehicle_that_passes_its_checks_without_a_position_is_not_armed_and_the_reason_is_told() -> None:
    async def scenario() -> None:
        async with doubtful_vehicle() as (_, autopilot):
            news: list[VehicleNews] = []
            autopilot.listen(news.append)
            await autopilot.claim(resumes=False)
            with pytest.raises(AutopilotRefused, match="does not know its position yet") as caught:
                await autopilot.ready()
            assert caught.value.vehicle_said == ""  # those were not its words
            assert ArmingDelayed(reasons=("it does not know its position yet",)) in news

    asyncio.run(scenario())


def test_a_target_that_the_vehicle_refuses_is_told_to_lie_outside_its_fence() -> None:
    async def scenario() -> None:
        async with doubtful_vehicle() as (_, autopilot):
            await autopilot.claim(resumes=False)
            with pytest.raises(AutopilotRefused, match=r"goto .*MAV_RESULT_FAILED.* outside its own fence"):
                await autopilot.goto(Position(10.0, 0.0, 5.0))

    asyncio.run(scenario())


def test_reports_that_never_come_are_asked_for_ever_more_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("upwash.real.mavlink.observed._HEARTBEAT_S", 0.02)

    async def scenario() -> None:
        async with doubtful_vehicle() as (vehicle, _):
            async with asyncio.timeout(5.0):
                while vehicle.asked.count(mavlink.MAVLINK_MSG_ID_FENCE_STATUS) < 11:  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
            vehicle.asked.clear()
            await asyncio.sleep(1.0)  # about 50 rounds
            assert vehicle.asked.count(mavlink.MAVLINK_MSG_ID_FENCE_STATUS) <= 3
            assert not vehicle.asked.count(mavlink.MAVLINK_MSG_ID_SYS_STATUS)

    asyncio.run(scenario())


def test_what_arrives_late_or_twice_changes_nothing() -> None:
    async def scenario() -> None:
        heard = asyncio.Event()
        codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

        class Vehicle(asyncio.DatagramProtocol):
            def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
                self.transport = transport

            def datagram_received(self, _data: bytes, sender: tuple[str, int]) -> None:
                self.sender = sender
                heard.set()

            def beat(self, sequence: int, mode: int) -> None:
                codec.seq = sequence
                message = mavlink.MAVLink_heartbeat_message(2, 3, 81, mode, 3, 3)
                self.transport.sendto(bytes(message.pack(codec)), self.sender)

        transport, vehicle = await asyncio.get_running_loop().create_datagram_endpoint(
            Vehicle, local_addr=("127.0.0.1", 0)
        )
        copter = MavlinkVehicle(
            f"udpout:127.0.0.1:{transport.get_extra_info('sockname')[1]}",
            Patience(quiet_after_s=0.3),
            [ARDUCOPTER],
        )
        await heard.wait()
        for sequence, mode, then in (
            (255, 0, 0),
            (1, 4, 4),  # the count begins anew after 255
            (0, 0, 4),  # late
            (1, 0, 4),  # twice
            (2, 6, 6),
            (208, 9, 6),  # as late as 50 messages, of which a vehicle sends as many in a second
            (150, 9, 9),  # too far back to be late: the vehicle was restarted
        ):
            vehicle.beat(sequence, mode)
            await asyncio.sleep(0.02)
            assert copter.telemetry.mode == then
        await copter.link_lost()
        vehicle.beat(149, 5)  # after a silence, anything is news
        await copter.link_restored()
        assert copter.telemetry.mode == 5
        await copter.close()
        transport.close()

    asyncio.run(scenario())
