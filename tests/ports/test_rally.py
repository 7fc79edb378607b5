"""Rally points: what the drivers read of them, and where returns end then, with the stand-ins of both firmwares."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AGILE, HASTY, HOME, driven
from tests.ports.scripted import FRAME, Px4Script, Script, scripted
from tests.ports.steps import take_off

from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.return_place import NO_RALLY_POINTS
from upwash.core.vehicle.way_home import ARDUCOPTER
from upwash.errors import AutopilotError, AutopilotRefused, AutopilotTimeout
from upwash.mavlink.px4 import EventMessage
from upwash.ports import VehicleLimits, VehicleNews
from upwash.real.mavlink import FlightSettings
from upwash.real.mavlink.settings import DriverPatience
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings

RALLY, MISSION = mavlink.MAV_MISSION_TYPE_RALLY, mavlink.MAV_MISSION_TYPE_MISSION
POINT, LAND = mavlink.MAV_CMD_NAV_RALLY_POINT, mavlink.MAV_CMD_NAV_LAND
RELATIVE, GLOBAL, TERRAIN = 3, 0, 10
ARDU = {"RALLY_TOTAL": 1.0, "RALLY_LIMIT_KM": 0.3, "RALLY_INCL_HOME": 1.0}
HOME_TOLD = mavlink.MAVLink_home_position_message(
    round(HOME.latitude_deg * 1e7), round(HOME.longitude_deg * 1e7), 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0
)
pytestmark = pytest.mark.virtual


def item(
    east_m: float, altitude_m: float, *, frame: int = RELATIVE, command: int = POINT, kind: int = RALLY
) -> Any:
    geo = FRAME.geo(Position(east_m, 0.0))
    x, y = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_mission_item_int_message(
        255, 191, 0, frame, command, 0, 1, 0, 0, 0, 0, x, y, altitude_m, kind
    )


async def limits_of(
    kind: type[Script], parameters: dict[str, float], *items: Any, mission: tuple[Any, ...] = ()
) -> tuple[VehicleLimits, Script]:
    async with scripted(kind=kind) as script:
        script.parameters |= parameters
        script.lists = {RALLY: numbered(items), MISSION: numbered(mission)}
        await script.say(HOME_TOLD)
        return await script.autopilot.limits(), script


def numbered(items: tuple[Any, ...]) -> list[Any]:
    for number, each in enumerate(items):
        each.seq = number
    return list(items)


async def test_an_arducopter_without_rally_points_is_not_asked_for_its_list() -> None:
    for parameters in {"RALLY_TOTAL": 0.0}, {}:
        limits, script = await limits_of(Script, parameters)
        assert limits.rally == NO_RALLY_POINTS
        assert not script.of_kind("MISSION_REQUEST_LIST")


async def test_an_arducopters_points_with_their_altitudes_and_its_rule() -> None:
    limits, script = await limits_of(Script, ARDU, item(100.0, 40.0), item(400.0, -10.0), item(50.0, 5.0))
    places = [(point.name, round(point.position.east_m), point.altitude_m) for point in limits.rally.points]
    top_m = ARDUCOPTER.altitude_m
    assert places == [
        ("rally point 1", 100, 40.0),
        ("rally point 2", 400, top_m),
        ("rally point 3", 50, top_m),
    ]
    assert limits.rally.points[1].position.altitude_m == -10.0, "it descends below home"
    assert (limits.rally.home_counts, limits.rally.nearer_by_m) == (True, 0.0)
    assert limits.rally.limit_m == pytest.approx(300.0)
    assert script.autopilot.energy.rally == limits.rally


@pytest.mark.parametrize(
    ("items", "parameters", "said"),
    [
        (
            [item(9.0, 30.0, frame=TERRAIN)],
            {},
            "rally point 1 has its altitude of 30 m in MAV_FRAME_GLOBAL_TERRAIN_ALT",
        ),
        ([item(9.0, 30.0)], {"RALLY_INCL_HOME": None}, "RALLY_INCL_HOME"),
    ],
)
async def test_rally_points_that_cannot_be_counted_are_refused(
    items: list[Any], parameters: dict[str, float | None], said: str
) -> None:
    told = {name: value for name, value in (ARDU | parameters).items() if value is not None}
    with pytest.raises(AutopilotRefused, match=said) as caught:
        await limits_of(Script, told, *items)
    assert "nothing was sent" in caught.value.problem


async def test_a_list_that_is_not_told_is_refused() -> None:
    class Silent(Script):
        def _answer(self, message: Any) -> None:
            if message.get_type() != "MISSION_REQUEST_LIST":
                super()._answer(message)

    with pytest.raises(
        AutopilotTimeout, match="did not tell how many items it has of its list of rally points"
    ):
        await limits_of(Silent, ARDU)


@pytest.mark.parametrize(
    ("kind", "home_counts", "names"),
    [
        (0, True, ["rally point 1"]),
        (1, False, ["rally point 1"]),
        (5, False, ["rally point 1", "rally point 2"]),
    ],
)
async def test_a_px4_uses_points_by_its_rtl_type(kind: int, home_counts: bool, names: list[str]) -> None:
    limits, _ = await limits_of(Px4Script, {"RTL_TYPE": float(kind)}, item(100.0, 40.0), item(6.0, 0.0))
    assert [point.name for point in limits.rally.points] == names, (
        "one at home counts only where home does not"
    )
    assert limits.rally.points[0].altitude_m == 70.0, "RTL_RETURN_ALT above the point"
    assert (limits.rally.home_counts, limits.rally.nearer_by_m) == (home_counts, 2.0)


@pytest.mark.parametrize(
    ("kind", "mission", "said"),
    [
        (2, (item(1.0, 10.0, command=16, kind=MISSION),), "returns follow the mission"),
        (3, (item(1.0, 0.0, command=LAND, kind=MISSION),), "returns may end at the landing of the mission"),
        (5, (), "a return lands wherever it last heard a ground station"),
    ],
)
async def test_a_px4_whose_return_ends_who_knows_where_is_refused(
    kind: int, mission: tuple[Any, ...], said: str
) -> None:
    with pytest.raises(AutopilotRefused, match=said):
        await limits_of(Px4Script, {"RTL_TYPE": float(kind)}, mission=mission)


async def test_a_px4_that_cannot_use_the_frame_of_a_point_is_refused() -> None:
    """It tells the frame as usable, and flies its return to no known place; every 2 s it says why."""
    async with scripted(kind=Px4Script) as script:
        script.parameters |= {"RTL_TYPE": 1.0}
        script.lists = {RALLY: numbered((item(100.0, 5.0, frame=6),)), MISSION: []}
        await script.say(HOME_TOLD)
        reading = asyncio.create_task(script.autopilot.limits())
        await asyncio.sleep(2.0)
        await script.say(
            EventMessage(
                id_of_event=26128688,
                event_time_boot_ms=2000,
                sequence=0,
                destination_component=0,
                destination_system=0,
                log_levels=0x33,
                arguments=bytes(40),
            )
        )
        with pytest.raises(AutopilotRefused, match="in a frame that its returns cannot use"):
            await reading


async def test_a_px4_with_a_mission_without_a_landing_or_with_none_is_flown() -> None:
    flown = item(1.0, 10.0, command=16, kind=MISSION)
    for kind, mission in (2, ()), (3, (flown,)), (0, (flown,)):
        limits, _ = await limits_of(Px4Script, {"RTL_TYPE": float(kind)}, mission=mission)
        assert limits.rally.points == ()


# --- the stand-ins ------------------------------------------------------------------------------------------

POINTS = tuple(
    replace(FRAME.geo(Position(east_m, 20.0)), altitude_m=altitude_m)
    for east_m, altitude_m in ((40.0, 12.0), (150.0, 20.0))
)
SITES: dict[str, VehicleSettings | Px4Settings] = {
    "arducopter": replace(AGILE, rally=POINTS),
    "px4": Px4Settings(HOME, rally=POINTS, parameters={"RTL_RETURN_ALT": 6.0, "RTL_DESCEND_ALT": 4.0}),
}
SETTINGS = FlightSettings(arm_again_s=0.2, progress_s=0.5, patience=DriverPatience(others_s=0.0))


@pytest.mark.parametrize(("east_m", "end"), [(45.0, Position(40.0, 20.0)), (10.0, Position(0.0, 0.0))])
@pytest.mark.parametrize("kind", SITES)
async def test_a_return_ends_where_the_driver_said(kind: str, east_m: float, end: Position) -> None:
    async with driven(SITES[kind], HASTY, ground_speed_m_s=20.0) as (_, autopilot):
        limits = await autopilot.limits()
        assert [point.name for point in limits.rally.points] == ["rally point 1", "rally point 2"]
        await take_off(autopilot)
        await autopilot.goto(Position(east_m, 20.0 if east_m > 20 else 0.0, 5.0))
        place = autopilot.energy.returns_to(autopilot.position)
        assert ground_distance_m(place.position, end) <= 0.1
        await autopilot.return_home_and_land()
        assert ground_distance_m(autopilot.position, end) <= 2.5


@pytest.mark.parametrize(
    ("settings", "name", "value", "low_m"),
    [
        (replace(AGILE, parameters={"RTL_ALT_FINAL": 300.0}), "RTL_ALT_FINAL", 300.0, 3.0),
        (
            Px4Settings(HOME, parameters={"RTL_LAND_DELAY": -1.0, "RTL_DESCEND_ALT": 7.0}),
            "RTL_LAND_DELAY",
            -1.0,
            7.0,
        ),
    ],
)
async def test_a_return_that_hovers_is_told_before_arming_and_hovers(
    settings: Any, name: str, value: float, low_m: float
) -> None:
    async with driven(settings, HASTY, ground_speed_m_s=20.0) as (_, autopilot):
        news: list[VehicleNews] = []
        autopilot.listen(news.append)
        await autopilot.limits()
        (told,) = [each for each in news if getattr(each, "name", "") == name]
        assert (told.value, "does not land" in told.advice) == (value, True)  # type: ignore[union-attr]
        await take_off(autopilot)
        await autopilot.goto(Position(20.0, 0.0, 5.0))
        with pytest.raises(AutopilotError):
            await autopilot.return_home_and_land()
        assert autopilot.position.altitude_m == pytest.approx(low_m, abs=1.0)
        await autopilot.land()
        assert ground_distance_m(autopilot.position, Position(0.0, 0.0)) <= 2.5


async def test_a_px4_waits_as_long_as_it_is_told_to_and_lands() -> None:
    flown_s = {}
    for delay_s in 0.0, 40.0:
        parameters = {"RTL_LAND_DELAY": delay_s, "RTL_RETURN_ALT": 10.0, "RTL_DESCEND_ALT": 10.0}
        settings = Px4Settings(HOME, parameters=parameters)
        async with driven(settings, HASTY, ground_speed_m_s=20.0) as (_, autopilot):
            await autopilot.limits()
            assert autopilot.energy.way_home is not None
            assert autopilot.energy.way_home.waits_s == delay_s
            await take_off(autopilot)
            begun_s = autopilot.vehicle.now_s
            await autopilot.return_home_and_land()
            flown_s[delay_s] = autopilot.vehicle.now_s - begun_s
    assert flown_s[40.0] - flown_s[0.0] == pytest.approx(40.0, abs=5.0)


@pytest.mark.parametrize(
    ("parameters", "name"),
    [({"RTL_LOIT_TIME": 90_000.0}, "RTL_LOIT_TIME"), ({"RTL_ALT_FINAL": -100.0}, "")],
)
async def test_a_long_wait_above_home_is_told_and_a_final_altitude_below_home_lands(
    parameters: dict[str, float], name: str
) -> None:
    async with driven(replace(AGILE, parameters=parameters)) as (_, autopilot):
        news: list[VehicleNews] = []
        autopilot.listen(news.append)
        await autopilot.limits()
        told = [each.name for each in news if getattr(each, "value", None) is not None]  # type: ignore[union-attr]
        assert told == [name] * bool(name)
        assert autopilot.energy.way_home is not None
        assert autopilot.energy.way_home.waits_s == 0.0
