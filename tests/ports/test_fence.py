"""What the drivers read of a vehicle's own fence before arming, against both stand-ins, on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import Bench, driven
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition, LocalFrame, Position, Waypoint
from upwash.drone.site import Site
from upwash.errors import AutopilotError, AutopilotOverruled, AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.px4 import Mode
from upwash.ports import VehicleLimits, VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.parameters import read_parameters
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection
from upwash.vehicle.body.copter import FaultKind, VehicleFault
from upwash.vehicle.px4.settings import Px4Settings

HOME = GeoPosition(39.3666, 22.9507)
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
STAY_IN = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
KEEP_OUT = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
Box = tuple[int, float, float, float, float]
WEST, EAST, GATE = (STAY_IN, -10, -10, 25, 10), (STAY_IN, -5, -10, 60, 10), (KEEP_OUT, 10, -5, 20, 5)
RADIUS = "50 m from its centre with a radius of 40 m"
TAKEOFF = "the take-off to 10 m: it is 10 m up, the fence ends at"
SITE = Site([Waypoint(0, Position(50.0, 0.0, 10.0))], (), farthest_start_m=500.0, takeoff_m=10.0)
ARDUCOPTER, PX4 = "arducopter", "px4"
RETURNS = {"COM_OBL_RC_ACT": 3.0}
Flight = Callable[[Bench, MavlinkAutopilot], Awaitable[None]]


def upload(sky: Bench, boxes: Sequence[Box]) -> None:
    """As a ground station does, without waiting for answers."""
    station = PeerConnection(sky.vehicle, write=lambda _: None)
    items = [
        (command, HOME_FRAME.geo(Position(east_m, north_m)))
        for command, west, south, east, north in boxes
        for east_m, north_m in ((west, south), (east, south), (east, north), (west, north))
    ]
    codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    messages = [mavlink.MAVLink_mission_count_message(1, 1, len(items), FENCE)]
    for seq, (command, place) in enumerate(items):
        x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        messages.append(
            mavlink.MAVLink_mission_item_int_message(1, 1, seq, 0, command, 0, 1, 4, 0, 0, 0, x, y, 0, FENCE)
        )
    for message in messages:
        for heard in mavlink.MAVLink(None).parse_buffer(bytes(message.pack(codec))) or []:
            station.hear(heard)


HOME_FRAME = LocalFrame(HOME)


def fly(flight: Flight, kind: str, parameters: Mapping[str, float], boxes: Sequence[Box] = ()) -> None:
    async def flown() -> None:
        vehicle: VehicleSettings | Px4Settings
        if kind == PX4:
            vehicle = Px4Settings(HOME, home_altitude_m=488.0, parameters={**RETURNS, **parameters})
        else:
            vehicle = VehicleSettings(
                HOME, home_altitude_m=488.0, armable_after_s=0.0, parameters=dict(parameters)
            )

        async def before(sky: Bench) -> None:
            upload(sky, boxes)

        async with driven(vehicle, before=before) as (sky, autopilot):
            await flight(sky, autopilot)

    run_virtually(flown())


def limits_of(kind: str, parameters: Mapping[str, float], boxes: Sequence[Box] = ()) -> VehicleLimits:
    found: list[VehicleLimits] = []

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.claim(resumes=False)
        await autopilot.ready()
        found.append(await autopilot.limits())
        assert sky.commands() == []

    fly(flight, kind, parameters, boxes)
    return found[0]


def refusal(limits: VehicleLimits) -> str:
    try:
        SITE.require_within(limits, Position(0.0, 0.0))
    except AutopilotRefused as error:
        return error.problem
    return ""


@pytest.mark.parametrize(
    ("kind", "parameters", "boxes", "said"),
    [
        (ARDUCOPTER, {"FENCE_ENABLE": 0, "FENCE_TYPE": 4}, [GATE], ""),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4}, [GATE], "crosses area 1"),
        (ARDUCOPTER, {"FENCE_AUTOENABLE": 1, "FENCE_TYPE": 4}, [GATE], "crosses area 1"),
        (ARDUCOPTER, {"FENCE_AUTOENABLE": 2, "FENCE_TYPE": 4}, [GATE], "crosses area 1"),
        (ARDUCOPTER, {"FENCE_AUTOENABLE": 3, "FENCE_TYPE": 4}, [GATE], "crosses area 1"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 1}, [GATE], ""),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 6, "FENCE_RADIUS": 40}, [], RADIUS),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4}, [WEST, EAST], "outside area 1"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4, "FENCE_OPTIONS": 2}, [WEST, EAST], ""),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4, "FENCE_OPTIONS": 2}, [WEST, EAST, GATE], "crosses area 3"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4, "FENCE_OPTIONS": 3}, [WEST], "outside area 1"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 1, "FENCE_ALT_MAX": 9}, [], f"{TAKEOFF} FENCE_ALT_MAX = 9 m"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 9, "FENCE_ALT_MIN": 12}, [], "begins at FENCE_ALT_MIN = 12 m"),
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 1, "FENCE_ALT_MAX": 14}, [], ""),  # it returns below that
        (PX4, {"GF_ACTION": 0}, [GATE], ""),
        (PX4, {"GF_ACTION": 1}, [GATE], "crosses area 1"),
        (PX4, {"GF_ACTION": 2}, [GATE], "crosses area 1"),
        (PX4, {"GF_MAX_HOR_DIST": 40}, [], RADIUS),
        (PX4, {}, [WEST, EAST], "outside area"),  # all of them have to hold
        (PX4, {"GF_MAX_VER_DIST": 9}, [], f"{TAKEOFF} GF_MAX_VER_DIST = 9 m"),
        (PX4, {"GF_MAX_VER_DIST": 25}, [], "at RTL_RETURN_ALT = 30 m: it ends at GF_MAX_VER_DIST = 25 m"),
        (PX4, {"GF_MAX_VER_DIST": 25, "RTL_RETURN_ALT": 20}, [], ""),
        (PX4, {"GF_ACTION": 4}, [], ""),  # no fence that it could leave
    ],
)  # fmt: skip
def test_a_mission_is_held_against_the_fence_that_counts(
    kind: str, parameters: dict[str, float], boxes: list[Box], said: str
) -> None:
    found = refusal(limits_of(kind, parameters, boxes))
    assert said in found
    assert bool(said) == bool(found)


@pytest.mark.parametrize("kind", [ARDUCOPTER, PX4])
def test_its_home_above_the_sea_is_among_its_limits(kind: str) -> None:
    assert limits_of(kind, {}).home_above_sea_m == pytest.approx(488.0, abs=0.5)


def test_a_px4_that_falls_at_its_fence_is_refused() -> None:
    with pytest.raises(AutopilotRefused, match=r"GF_ACTION is 4 \(terminate\).* nothing was sent"):
        limits_of(PX4, {"GF_ACTION": 4, "GF_MAX_HOR_DIST": 100})


@pytest.mark.parametrize(
    ("kind", "parameters", "said"),
    [
        (ARDUCOPTER, {"FENCE_ENABLE": 1, "FENCE_TYPE": 4}, "Vehicle breaching Polygon fence"),
        (ARDUCOPTER, {"FENCE_AUTOENABLE": 3, "FENCE_TYPE": 4}, "Vehicle breaching Polygon fence"),
        (PX4, {}, "geofence: outside"),
    ],
)
def test_a_vehicle_that_stands_outside_its_fence_says_that(
    kind: str, parameters: dict[str, float], said: str
) -> None:
    with pytest.raises(AutopilotRefused, match="was not ready") as caught:
        limits_of(kind, parameters, [(KEEP_OUT, -5, -5, 5, 5)])
    assert said in caught.value.vehicle_said


def test_at_the_end_of_a_take_off_a_fence_that_is_switched_on_then_counts_where_it_stands() -> None:
    limits = limits_of(ARDUCOPTER, {"FENCE_AUTOENABLE": 1, "FENCE_TYPE": 4}, [(KEEP_OUT, -5, -5, 5, 5)])
    assert "the place where the vehicle stands (0 m east, 0 m north): it lies inside" in refusal(limits)


@played(fly, PX4, {"GF_PREDICT": 1, "GF_MAX_HOR_DIST": 100})
async def test_what_happens_at_a_px4s_fence_is_told(_: Bench, autopilot: MavlinkAutopilot) -> None:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    await autopilot.limits()
    told = {each.name for each in news if isinstance(each, VehicleSetting)}
    assert {"GF_ACTION", "GF_PREDICT"} <= told


@pytest.mark.parametrize(("avoids", "told"), [({}, []), ({"OA_TYPE": 0.0}, []), ({"OA_TYPE": 1.0}, [1.0])])
def test_an_arducopter_that_flies_round_obstacles_is_told(
    monkeypatch: pytest.MonkeyPatch, avoids: dict[str, float], told: list[float]
) -> None:
    news: list[VehicleNews] = []

    async def read(vehicle: MavlinkVehicle, names: Sequence[str]) -> dict[str, float]:
        return {**await read_parameters(vehicle, names), **avoids}

    async def flight(_: Bench, autopilot: MavlinkAutopilot) -> None:
        autopilot.listen(news.append)
        await autopilot.limits()

    monkeypatch.setattr("upwash.real.mavlink.arducopter.read_parameters", read)
    fly(flight, ARDUCOPTER, {})
    found = [each for each in news if isinstance(each, VehicleSetting) and each.name == "OA_TYPE"]
    assert [each.value for each in found] == told


def test_a_fence_that_a_vehicle_does_not_tell_is_a_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    async def told_nothing(*_: object) -> dict[str, float]:
        return {}

    monkeypatch.setattr("upwash.real.mavlink.arducopter.read_parameters", told_nothing)
    limits = limits_of(ARDUCOPTER, {"FENCE_ENABLE": 1})
    assert list(SITE.doubts(limits, Position(0.0, 0.0))) == [
        "the vehicle did not tell FENCE_ENABLE: the mission is not held against all of its own fence"
    ]


@pytest.mark.parametrize(
    ("action", "lost", "modes"),
    [
        (2, 3, [Mode.LOITER, Mode.RTL]),
        (2, 5, [Mode.LOITER]),
        (3, 5, [Mode.LOITER, Mode.RTL]),  # COM_FAIL_ACT_T in Hold before it returns
        (5, 3, [Mode.LOITER, Mode.LAND]),
    ],
)
def test_what_a_px4_does_at_its_fence_once_the_program_sends_no_more(
    action: int, lost: int, modes: list[Mode]
) -> None:
    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        await take_off(autopilot, 10.0)
        with pytest.raises(AutopilotOverruled):
            await autopilot.goto(Position(60.0, 0.0, 10.0))
        lost_s, seen = sky.now_s, [sky.copter.mode]
        while sky.now_s < lost_s + 8.0:
            await asyncio.sleep(0.1)
            if sky.copter.mode is not seen[-1]:
                seen.append(sky.copter.mode)
        assert seen == modes
        assert sky.commands(lost_s + 0.1) == []
        assert sky.setpoints(lost_s + 0.1) == 0

    fly(flight, PX4, {"GF_MAX_HOR_DIST": 30, "GF_ACTION": action, "COM_OBL_RC_ACT": lost})


@played(fly, PX4, {"GF_MAX_HOR_DIST": 30})
async def test_a_px4_falls_where_its_fence_ends_the_flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
    await take_off(autopilot, 10.0)
    sky.copter.parameters.change("GF_ACTION", 4)
    with pytest.raises(AutopilotError, match=r"disarm|motors"):
        await autopilot.goto(Position(60.0, 0.0, 10.0))
    assert not sky.copter.armed


@pytest.mark.parametrize(("armable_after_s", "told"), [(0.0, 0), (60.0, 1)])
@pytest.mark.virtual
async def test_how_high_its_home_lies_is_waited_for(armable_after_s: float, told: int) -> None:
    settings = VehicleSettings(HOME, home_altitude_m=488.0, armable_after_s=armable_after_s)
    async with driven(settings) as (sky, autopilot):
        delays: list[float] = []
        assert await autopilot.home_above_sea_m(lambda: delays.append(sky.now_s)) == 488.0
        assert len(delays) == told
        assert sky.commands() == []


@pytest.mark.virtual
async def test_a_home_that_is_never_told_is_refused() -> None:
    settings = VehicleSettings(HOME, faults=(VehicleFault(FaultKind.GPS),))
    async with driven(settings) as (sky, autopilot):
        with pytest.raises(AutopilotRefused, match="did not tell its home within 120 s"):
            await autopilot.home_above_sea_m(lambda: None)
        assert sky.commands() == []
