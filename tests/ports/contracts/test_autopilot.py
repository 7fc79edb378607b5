"""What every Autopilot does: the model on virtual time, and the MAVLink driver with the stand-in vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import pytest
from tests.played import played
from tests.ports.memory import AGILE, HASTY, HOME, driven
from tests.ports.steps import take_off

from upwash.config.world import FaultConfig
from upwash.core.geo import Circle, LocalFrame, Position, distance_m, ground_distance_m
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.ports import Autopilot
from upwash.real.mavlink import FlightSettings
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.loop import run_virtually
from upwash.sim.vehicle import FlightModel, Plain
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.px4.settings import Px4Settings

SPEED_M_S = 60.0
Flight = Callable[[Autopilot], Awaitable[None]]
Fly = Callable[[Flight], None]


@asynccontextmanager
async def px4_autopilot() -> AsyncIterator[Autopilot]:
    settings = Px4Settings(HOME, home_altitude_m=488.0)
    flight = FlightSettings(arrival_distance_m=0.8)  # it may drift on a little while it lands
    async with driven(settings, flight, ground_speed_m_s=SPEED_M_S) as (_, autopilot):
        yield autopilot


@asynccontextmanager
async def mavlink_autopilot() -> AsyncIterator[Autopilot]:
    async with driven(AGILE, HASTY, SPEED_M_S) as (_, autopilot):
        yield autopilot


DOUBT_FROM_S, DOUBT_UNTIL_S = 20.0, 45.0
DOUBT = FaultConfig(
    target="autopilot", kind="jump", from_s=DOUBT_FROM_S, to_s=DOUBT_UNTIL_S, moved_m=(0.0, 50.0, 0.0)
)


@asynccontextmanager
async def doubting_mavlink_autopilot() -> AsyncIterator[Autopilot]:
    async with driven(AGILE, HASTY, SPEED_M_S) as (sky, autopilot):
        loop = asyncio.get_running_loop()
        loop.call_at(DOUBT_FROM_S - 12.0, sky.fail, FaultKind.GLITCH)  # its filter believes it 10 s later
        loop.call_at(DOUBT_UNTIL_S, sky.mend, FaultKind.GLITCH)
        yield autopilot


def model(
    manner: FlightModel, *incidents: FaultConfig
) -> Callable[[], AbstractAsyncContextManager[Autopilot]]:
    @asynccontextmanager
    async def made() -> AsyncIterator[Autopilot]:
        autopilot = ModelAutopilot(
            Position(0.0, 0.0),
            ground_speed_m_s=SPEED_M_S,
            manner=manner,
            frame=LocalFrame(HOME),
            incidents=incidents,
        )
        yield autopilot
        await autopilot.close()

    return made


PLAIN = Plain(acceleration_m_s2=300.0, takeoff_s=1.0, return_and_land_s=1.0)


@pytest.fixture(params=["plain model", "arducopter model", "mavlink", "px4"])
def fly(request: pytest.FixtureRequest) -> Fly:
    """Runs a flight with one of the twins."""
    make = {
        "plain model": model(PLAIN),
        "arducopter model": model(arducopter),
        "mavlink": mavlink_autopilot,
        "px4": px4_autopilot,
    }[request.param]

    return flying(make)


@pytest.fixture(params=["plain model", "arducopter model", "mavlink"])
def fly_in_doubt(request: pytest.FixtureRequest) -> Fly:
    """The same, where the reported position is off by 50 m for a while."""
    make = {
        "plain model": model(PLAIN, DOUBT),
        "arducopter model": model(arducopter, DOUBT),
        "mavlink": doubting_mavlink_autopilot,
    }[request.param]
    return flying(make)


def flying(make: Callable[[], AbstractAsyncContextManager[Autopilot]]) -> Fly:
    def flown(flight: Flight) -> None:
        async def with_autopilot() -> None:
            async with make() as autopilot:
                await flight(autopilot)

        run_virtually(with_autopilot())

    return flown


@played("fly_in_doubt")
async def test_it_says_whether_its_position_is_sure_and_arrives_nowhere_in_doubt(
    autopilot: Autopilot,
) -> None:
    loop = asyncio.get_running_loop()
    await take_off(autopilot)
    assert autopilot.position_is_sure
    await asyncio.sleep(DOUBT_FROM_S + 1.0 - loop.time())
    assert not autopilot.position_is_sure
    leg = asyncio.create_task(autopilot.goto(Position(20.0, 0.0, 5.0)))
    await asyncio.sleep(DOUBT_UNTIL_S - 1.0 - loop.time())
    assert not autopilot.position_is_sure and not leg.done()
    await leg
    assert autopilot.position_is_sure
    assert distance_m(autopilot.position, Position(20.0, 0.0, 5.0)) <= 1.01


@played("fly")
async def test_each_verb_returns_when_it_is_true(autopilot: Autopilot) -> None:
    assert not await autopilot.in_the_air()
    assert autopilot.stands and not autopilot.armed
    await take_off(autopilot)
    assert await autopilot.in_the_air()
    assert distance_m(autopilot.position, Position(0.0, 0.0, 5.0)) <= 1.0
    for waypoint in Position(10.0, 0.0, 5.0), Position(10.0, -10.0, 7.0):
        await autopilot.goto(waypoint)
        assert distance_m(autopilot.position, waypoint) <= 1.01
    await autopilot.return_home_and_land()
    assert distance_m(autopilot.position, Position(0.0, 0.0, 0.0)) <= 1.0
    assert not await autopilot.in_the_air()
    await autopilot.disarm()


@played("fly")
async def test_it_turns_its_nose_until_the_next_leg_and_tells_how_it_flies(autopilot: Autopilot) -> None:
    await take_off(autopilot)
    for heading_deg in 200.0, 30.0:
        await autopilot.turn_to(heading_deg)
        told = autopilot.telemetry
        assert told.heading_deg == pytest.approx(heading_deg, abs=6.0)
        assert told.attitude is not None
        assert told.attitude.yaw_deg == pytest.approx(heading_deg, abs=25.0)  # told four times a second
    assert distance_m(autopilot.position, Position(0.0, 0.0, 5.0)) <= 1.0
    assert told.armed
    assert told.mode == autopilot.telemetry.mode != ""
    assert told.ground_speed_m_s == pytest.approx(0.0, abs=0.5)
    assert told.gps is not None
    assert told.gps.kind != "none"
    assert told.gps.satellites is not None
    await autopilot.goto(Position(30.0, 0.0, 5.0))  # east
    assert autopilot.telemetry.position == autopilot.position
    await autopilot.return_home_and_land()


@played("fly")
async def test_what_it_carries_obeys_while_the_vehicle_is_the_programs(autopilot: Autopilot) -> None:
    for verb in autopilot.command(183, "DO_SET_SERVO", (9.0, 1500.0)), autopilot.turn_to(90.0):
        with pytest.raises(AutopilotOverruled, match="the program has not taken the vehicle"):
            await verb
    autopilot.say(6, "a text that takes more than one chunk of fifty bytes on its way to the ground station")
    await autopilot.claim(resumes=False)
    await autopilot.command(183, "DO_SET_SERVO", (9.0, 1500.0))
    with pytest.raises(AutopilotRefused, match="on the ground"):
        await autopilot.turn_to(90.0)


@played("fly")
async def test_it_lands_where_it_is(autopilot: Autopilot) -> None:
    await take_off(autopilot)
    await autopilot.goto(Position(8.0, 6.0, 5.0))
    await autopilot.land()
    assert distance_m(autopilot.position, Position(8.0, 6.0, 0.0)) <= 1.01
    await autopilot.disarm()


@played("fly")
async def test_what_cannot_be_is_refused(autopilot: Autopilot) -> None:
    with pytest.raises(AutopilotOverruled, match="the program has not taken the vehicle"):
        await autopilot.arm()
    await autopilot.claim(resumes=False)
    with pytest.raises(AutopilotRefused):
        await autopilot.takeoff(5.0)
    with pytest.raises(AutopilotRefused):
        await autopilot.goto(Position(10.0, 0.0, 5.0))
    await take_off(autopilot)
    with pytest.raises(AutopilotRefused):
        await autopilot.disarm()
    await autopilot.land()
    await autopilot.disarm()


@played("fly")
async def test_a_leg_can_be_broken_off_and_held(autopilot: Autopilot) -> None:
    await take_off(autopilot)
    await autopilot.set_ground_speed(10.0)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1.5):
            await autopilot.goto(Position(500.0, 0.0, 5.0))
    left, stop = autopilot.position, autopilot.stopping_place
    await autopilot.hold()
    here = autopilot.position
    assert 0.5 < here.east_m < 100.0
    assert left.east_m < here.east_m <= stop.east_m + 1.5, "it stops where it said, or before"
    await asyncio.sleep(0.3)
    assert distance_m(autopilot.position, here) <= 1.0
    await autopilot.goto(Position(here.east_m + 3.0, 0.0, 5.0))


def test_a_border_is_reported_when_it_is_crossed_and_not_before(fly: Fly) -> None:
    area = Circle(Position(20.0, 0.0), 8.0)

    async def mission(autopilot: Autopilot) -> None:
        await take_off(autopilot)
        await autopilot.set_ground_speed(10.0)
        seen_m: list[float] = []

        async def watch() -> None:
            for _ in range(2):
                await autopilot.border_crossed([area])
                seen_m.append(ground_distance_m(autopilot.position, Position(0.0, 0.0)))

        watching = asyncio.create_task(watch())
        await asyncio.sleep(0.2)
        assert seen_m == []
        await autopilot.goto(Position(40.0, 0.0, 5.0))
        await watching
        entered_m, left_m = seen_m
        assert 12.0 - 0.01 <= entered_m < 20.0  # a report comes late on a busy machine
        assert 28.0 - 0.01 <= left_m < 36.0

    fly(mission)


@played("fly")
async def test_it_says_where_on_the_earth_it_is(autopilot: Autopilot) -> None:
    await take_off(autopilot)
    place = Position(30.0, -40.0, 8.0)
    await autopilot.goto(place)
    told = autopilot.earth_position
    assert told is not None
    expected = LocalFrame(HOME).geo(autopilot.position)
    assert abs(told.latitude_deg - expected.latitude_deg) < 1e-6
    assert abs(told.longitude_deg - expected.longitude_deg) < 1e-6
    if told.above_sea_m is not None:  # a model does not know how high its ground is
        ground_m = told.above_sea_m - autopilot.position.altitude_m
        home_m = 488.0 if autopilot.telemetry.mode == "OFFBOARD" else 0.0
        assert abs(ground_m - home_m) < 1.0  # a PX4's home is where it was armed, by its estimate
