"""Who has the vehicle, and where it is, when others act on it: the driver against the stand-in, on real sockets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.steps import claim_and_arm, take_off
from tests.ports.test_autopilot import AGILE, FRAME, HASTY, connected, connection

from upwash.core.geo import Position, distance_m
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import HomeMoved, PositionDoubted, VehicleSaid
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkLink, connect_autopilot
from upwash.vehicle.ardupilot.copter import FORCED_DISARM
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.server import VehicleServer, serve_vehicle

SLOW_FALL = replace(AGILE, climb_m_s=20.0)
CLEARED = "Glitch cleared"
FAITHFUL = VehicleSettings(
    home=FRAME.home, speedup=10.0, armable_after_s=3.0, parameters={"DISARM_DELAY": 100.0}
)
HURRIED = replace(HASTY, margin_s=4.0)
QUICK_CLOCK = replace(AGILE, speedup=20.0)  # so that it goes back by more than a late message does


def command_int(
    number: int, place: Position, *, frame: int, parameters: tuple[float, ...] = (0.0,) * 4
) -> Any:
    geo = FRAME.geo(place)
    degrees_e7 = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, number, 0, 0, *parameters, *degrees_e7, place.altitude_m
    )


def fly_to_here(place: Position) -> Any:
    return command_int(
        mavlink.MAV_CMD_DO_REPOSITION,
        place,
        frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        parameters=(-1.0, 1.0, 0.0, 0.0),
    )


async def ground_station(vehicle: VehicleServer) -> MavlinkLink:
    link = MavlinkLink(connection(vehicle), lambda _: None)
    await link.opened.wait()
    return link


async def turns_true(look: Callable[[], bool], *, within_s: float = 20.0) -> None:
    """Waits for what another side of a socket does."""
    async with asyncio.timeout(within_s):
        while not look():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


ELSEWHERE = Position(-52.0, 0.0, 3.0)
TARGETS = {"in a leg": True, "between two verbs": False}


@pytest.mark.parametrize("flies", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("target", [ELSEWHERE, Position(0.0, 0.0, 30.0)], ids=["elsewhere", "higher"])
def test_a_target_of_a_ground_station_in_the_programs_mode_ends_what_the_program_sends(
    flies: bool, target: Position
) -> None:
    async def mission() -> None:
        async with connected(ground_speed_m_s=10.0) as (vehicle, autopilot):
            await take_off(autopilot, 3.0)
            await autopilot.goto(Position(1.0, 0.0, 3.0))
            station = await ground_station(vehicle)
            leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 3.0))) if flies else None
            await asyncio.sleep(0.4)
            station.send(fly_to_here(target))
            await turns_true(lambda: not autopilot.control.is_ours)
            if leg:
                with pytest.raises(AutopilotOverruled, match="a ground station or another program"):
                    await leg
            assert autopilot.control.owner is Owner.GROUND_STATION
            with pytest.raises(AutopilotOverruled, match="from where the program sent it; nothing was sent"):
                await autopilot.goto(Position(0.0, 0.0, 3.0))
            await turns_true(lambda: distance_m(autopilot.position, target) <= 1)
            await station.close()

    asyncio.run(mission())


def test_a_home_that_is_moved_in_flight_changes_no_altitude_and_is_where_it_returns_to() -> None:
    async def mission() -> None:
        async with connected() as (vehicle, autopilot):
            news: list[VehicleNews] = []
            autopilot.listen(news.append)
            await take_off(autopilot, 15.0)
            await autopilot.goto(Position(5.0, 0.0, 15.0))
            station = await ground_station(vehicle)
            new_home = Position(40.0, 30.0, -12.0)
            station.send(
                command_int(
                    mavlink.MAV_CMD_DO_SET_HOME, new_home, frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
                )
            )
            await turns_true(lambda: any(isinstance(each, HomeMoved) for each in news))
            assert autopilot.position.altitude_m == pytest.approx(15.0, abs=0.5)
            await autopilot.goto(Position(10.0, 0.0, 15.0))
            assert truth(vehicle).altitude_m == pytest.approx(15.0, abs=0.5)
            moved = [
                Position(each.east_m, each.north_m, each.altitude_m)
                for each in news
                if isinstance(each, HomeMoved)
            ]
            assert [distance_m(each, new_home) < 0.5 for each in moved] == [True]
            await autopilot.return_home_and_land()
            assert distance_m(truth(vehicle), new_home.at_altitude(0.0)) < 1
            assert autopilot.control.is_ours
            await station.close()

    asyncio.run(mission())


def truth(vehicle: VehicleServer) -> Position:
    standing: Any = vehicle._vehicle
    place: Position = standing.firmware.copter.position(standing.now_s())
    return place


@pytest.mark.parametrize("ends", [True, False])
def test_a_jump_of_the_position_is_no_arrival_whatever_the_vehicle_says_of_it(ends: bool) -> None:
    async def mission() -> None:
        waypoint = Position(0.0, 40.0, 5.0)
        async with connected(vehicle_settings=FAITHFUL, settings=HURRIED, ground_speed_m_s=5.0) as (
            vehicle,
            autopilot,
        ):
            news: list[VehicleNews] = []
            autopilot.listen(news.append)
            await take_off(autopilot, 5.0)
            vehicle.fail(FaultKind.GLITCH)
            await turns_true(lambda: any(isinstance(each, PositionDoubted) for each in news))
            leg = asyncio.create_task(autopilot.goto(waypoint))
            await turns_true(
                lambda: any(isinstance(each, VehicleSaid) and each.text == CLEARED for each in news)
            )
            await asyncio.sleep(1.5)
            assert distance_m(autopilot.position, waypoint) < 1  # it says that it is there
            assert not leg.done()
            if ends:
                vehicle.mend(FaultKind.GLITCH)
                await leg
                assert not autopilot._tracker.doubt
            else:
                with pytest.raises(AutopilotTimeout, match=r"jumped 5[56] m, farther than it can fly"):
                    await leg
                await autopilot.hold()

    asyncio.run(mission())


def test_motors_that_stop_in_the_air_are_no_pilots_act_and_no_landing() -> None:
    async def mission() -> None:
        async with connected(vehicle_settings=SLOW_FALL) as (vehicle, autopilot):
            await take_off(autopilot, 30.0)
            station = await ground_station(vehicle)
            leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 30.0)))
            await asyncio.sleep(0.4)
            stop = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
            station.send(mavlink.MAVLink_command_long_message(1, 1, stop, 0, 0, FORCED_DISARM, *(0.0,) * 5))
            with pytest.raises(AutopilotOverruled, match="its motors stopped in the air"):
                await leg
            assert autopilot.control.owner is Owner.UNKNOWN
            assert not autopilot.stands
            async with asyncio.timeout(10):
                await autopilot.stood()
            assert autopilot.stands
            await station.close()

    asyncio.run(mission())


def test_an_autopilot_that_restarts_in_flight_is_named_and_no_person_is() -> None:
    async def mission() -> None:
        async with connected("tcp:127.0.0.1:0", QUICK_CLOCK) as (vehicle, autopilot):
            await take_off(autopilot, 3.0)
            await asyncio.sleep(1.0)
            address = vehicle.address
            await vehicle.close()
            again = await serve_vehicle(address, AGILE)
            try:
                await turns_true(lambda: "its autopilot restarted" in autopilot.control.why)
                assert autopilot.control.owner is Owner.UNKNOWN
                with pytest.raises(AutopilotOverruled):
                    await autopilot.claim(resumes=True)
            finally:
                await again.close()

    asyncio.run(mission())


def test_an_autopilot_that_restarts_before_the_flight_is_armed_all_the_same() -> None:
    async def mission() -> None:
        async with connected("tcp:127.0.0.1:0") as (vehicle, autopilot):
            await autopilot.claim(resumes=False)
            await asyncio.sleep(1.0)
            address = vehicle.address
            await vehicle.close()
            again = await serve_vehicle(address, AGILE)
            try:
                async with asyncio.timeout(20):
                    await claim_and_arm(autopilot)
                assert autopilot.control.is_ours
            finally:
                await again.close()

    asyncio.run(mission())


class _Merger(asyncio.DatagramProtocol):
    """A radio on which two vehicles with one identity are heard."""

    def __init__(self, vehicles: list[tuple[str, int]]) -> None:
        self.heard = vehicles[:1]
        self._vehicles = vehicles
        self._drone: Any = None
        self._said: list[bytes] = []  # by the drone so far

    def join(self, vehicle: tuple[str, int]) -> None:
        """One more is heard, which hears all that was said, too."""
        self.heard.append(vehicle)
        for data in self._said:
            self._transport.sendto(data, vehicle)

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, sender: Any) -> None:
        if sender in self._vehicles:
            if self._drone:
                self._transport.sendto(data, self._drone)
            return
        self._drone = sender
        self._said.append(data)
        for vehicle in self.heard:
            self._transport.sendto(data, vehicle)


@asynccontextmanager
async def two_vehicles_with_one_identity() -> Any:
    homes = FRAME.home, FRAME.geo(Position(89.0, 0.0))
    vehicles = [await serve_vehicle("udp:127.0.0.1:0", replace(AGILE, home=home)) for home in homes]
    places = [("127.0.0.1", int(each.address.rpartition(":")[2])) for each in vehicles]
    transport, merger = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Merger(places), local_addr=("127.0.0.1", 0)
    )
    asyncio.get_running_loop().call_later(4.0, merger.join, places[1])  # their numbers must differ
    try:
        yield f"udpout:127.0.0.1:{transport.get_extra_info('sockname')[1]}", vehicles
    finally:
        transport.close()
        for each in vehicles:
            await each.close()


def test_two_vehicles_with_one_identity_are_not_armed() -> None:
    async def mission() -> None:
        async with two_vehicles_with_one_identity() as (link, vehicles):
            autopilot = await connect_autopilot(link, frame=FRAME, ground_speed_m_s=5.0, settings=HASTY)
            try:
                await autopilot.claim(resumes=False)
                await asyncio.sleep(5.0)
                with pytest.raises(AutopilotRefused, match="two vehicles"):
                    async with asyncio.timeout(20):
                        await autopilot.ready()
                        await autopilot.arm()
                assert not any(armed(each) for each in vehicles)
            finally:
                await autopilot.close()

    asyncio.run(mission())


def armed(vehicle: VehicleServer) -> bool:
    standing: Any = vehicle._vehicle
    return bool(standing.firmware.copter.armed(standing.now_s()))
