"""What the drivers make of a vehicle's fence: each of its parameters, and its list of areas item by item."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import FRAME, SYSTEM, Px4Script, Script, scripted

from upwash.core.geo import Circle, Position, distance_m
from upwash.core.vehicle.geofence import AreaUnion, Polygon
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import VehicleSetting
from upwash.ports import FenceNames, VehicleLimits
from upwash.sim.loop import run_virtually

FENCE, MISSION = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_MISSION
STAY_IN = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
KEEP_OUT = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
CIRCLE_IN, CIRCLE_OUT = (
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
)
BACK = mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT
Item = tuple[int, float, int, int]  # command, first parameter, latitude and longitude in 1e-7 degrees


def at(command: int, size: float, east_m: float, north_m: float = 0.0) -> Item:
    geo = FRAME.geo(Position(east_m, north_m))
    return command, size, round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)


def polygon(command: int, *corners: tuple[float, float]) -> list[Item]:
    return [at(command, len(corners), *corner) for corner in corners]


TRIANGLE = (0.0, 0.0), (50.0, 0.0), (0.0, 50.0)
OTHERS = (10.0, 0.0), (60.0, 0.0), (10.0, 50.0), (5.0, 5.0)


class Fenced(Script):
    """A vehicle with a list of areas, all of which count."""

    def __init__(self, *, armed: bool) -> None:
        super().__init__(armed=armed)
        self.parameters |= {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0, "FENCE_OPTIONS": 0.0, "FENCE_MARGIN": 2.0}
        self.items: list[Item] = []
        self.takes_s = 0.0
        self.also: Callable[[Any], list[Any]] = lambda _: []  # what comes before an answer
        self.silent: set[int | None] = set()  # about these items, None: about their number

    def _answer(self, message: Any) -> None:
        kind = message.get_type()
        is_about_fence = kind.startswith("MISSION_REQUEST") and message.mission_type == FENCE
        if not is_about_fence:
            super()._answer(message)
            return
        assert (message.target_system, message.target_component, message.mission_type) == (SYSTEM, 1, FENCE)
        number = message.seq if kind == "MISSION_REQUEST_INT" else None
        right = count(len(self.items)) if number is None else item(number, self.items[number])
        answers = [*self.also(message), *([] if number in self.silent else [right])]
        asyncio.get_running_loop().call_later(self.takes_s, self._send, answers)


def count(number: int, kind: int = FENCE) -> Any:
    return mavlink.MAVLink_mission_count_message(255, 191, number, kind)


def item(number: int, told: Item, kind: int = FENCE) -> Any:
    command, size, x, y = told
    return mavlink.MAVLink_mission_item_int_message(
        255, 191, number, 3, command, 0, 1, size, 0, 0, 0, x, y, 0, kind
    )


def tell(story: Callable[[Fenced], Awaitable[None]]) -> None:
    async def live() -> None:
        async with scripted(kind=Fenced) as script:
            assert isinstance(script, Fenced)
            await story(script)

    run_virtually(live())


async def areas(script: Fenced, *items: Item) -> list[tuple[str, object, bool]]:
    script.items = list(items)
    limits = await script.autopilot.limits()
    return [(fence.name, fence.area, fence.inclusion) for fence in limits.fences]


# --- the list -----------------------------------------------------------------------------------------------


@played(tell)
async def test_areas_are_polygons_and_circles_to_stay_in_or_out_of(script: Fenced) -> None:
    found = await areas(
        script,
        *polygon(STAY_IN, *TRIANGLE),
        at(CIRCLE_OUT, 20.0, 30.0, 40.0),
        at(BACK, 0.0, 5.0),
        *polygon(KEEP_OUT, *OTHERS),
        at(CIRCLE_IN, 1e6, 0.0),
        at(CIRCLE_OUT, 0.0, 0.0),
    )
    names = [f"area {number} of the vehicle's fence" for number in range(1, 6)]
    assert [name for name, _, _ in found] == names
    assert [inclusion for _, _, inclusion in found] == [True, False, False, True, False]
    for area, corners in (found[0][1], TRIANGLE), (found[2][1], OTHERS):
        assert isinstance(area, Polygon)
        for corner, (east_m, north_m) in zip(area.corners, corners, strict=True):
            assert distance_m(corner, Position(east_m, north_m)) < 0.02
    circle = found[1][1]
    assert isinstance(circle, Circle)
    assert circle.radius_m == 20.0 and distance_m(circle.centre, Position(30.0, 40.0)) < 0.02
    (ack,) = script.of_kind("MISSION_ACK")
    assert (ack.target_system, ack.target_component, ack.type, ack.mission_type) == (SYSTEM, 1, 0, FENCE)


@pytest.mark.parametrize(("options", "joined"), [(0.0, False), (1.0, False), (2.0, True), (3.0, True)])
@played(tell)
async def test_areas_to_stay_in_are_joined_if_the_vehicle_joins_them(
    script: Fenced, *, options: float, joined: bool
) -> None:
    script.parameters["FENCE_OPTIONS"] = options
    out, near, far = at(CIRCLE_OUT, 1.0, 9.0), at(CIRCLE_IN, 20.0, 0.0), at(CIRCLE_IN, 20.0, 30.0)
    found = await areas(script, near, out, far)
    if joined:
        (name, union, inclusion), (_, circle, _) = found
        assert isinstance(union, AreaUnion) and isinstance(circle, Circle)
        assert len(union.areas) == 2 and circle.radius_m == 1.0
        assert (name, inclusion) == ("all 2 areas to stay in of the vehicle's fence", True)
    else:
        assert len(found) == 3
    assert next(name for name, _, _ in await areas(script, near, out)) == "area 1 of the vehicle's fence"


TOO_FAR_E7 = 1_800_000_001


@pytest.mark.parametrize(
    ("items", "said"),
    [
        ([(CIRCLE_IN, 5.0, 900_000_001, 0)], r"item 0 has a latitude of 9e\+08"),
        ([(CIRCLE_IN, 5.0, 0, TOO_FAR_E7)], r"item 0 has a longitude of 1.8e\+09"),
        ([(CIRCLE_IN, 5.0, 0, -TOO_FAR_E7)], r"item 0 has a longitude of -1.8e\+09"),
        ([at(CIRCLE_IN, -0.5, 0.0)], "item 0 has a size of -0.5"),
        ([at(BACK, 0.0, 0.0), at(CIRCLE_OUT, 1e6 + 0.5, 0.0)], r"item 1 has a size of 1e\+06"),
        ([at(CIRCLE_IN, float("nan"), 0.0)], "item 0 has a size of nan"),
        (polygon(STAY_IN, *TRIANGLE[:2]), "item 0 has a size of 2"),
        ([at(STAY_IN, 1000.5, 0.0)], "item 0 has a size of 1000.5"),
        ([at(STAY_IN, 1000.0, 0.0)], "its last area has 1 of 1000 corners"),
        (
            [*polygon(KEEP_OUT, *TRIANGLE), *polygon(STAY_IN, *TRIANGLE)[:2]],
            "its last area has 2 of 3 corners",
        ),
        (
            [at(STAY_IN, 3, 0.0), at(KEEP_OUT, 3, 9.0)],
            "the corners of area 1 of the vehicle's fence belong to different",
        ),
        ([at(STAY_IN, 3, 0.0), at(STAY_IN, 4, 9.0)], "the corners of area 1"),
    ],
)
@played(tell)
async def test_a_list_with_an_impossible_item_is_refused(
    script: Fenced, *, items: list[Item], said: str
) -> None:
    with pytest.raises(AutopilotRefused, match=f"the vehicle's fence makes no sense: {said}") as caught:
        await areas(script, *items)
    assert "upload the fence anew; nothing was sent" in caught.value.problem


@played(tell)
async def test_places_at_the_edges_of_the_earth_and_of_what_does_not_count_are_no_nonsense(
    script: Fenced,
) -> None:
    edges = [(CIRCLE_OUT, 5.0, lat, lon) for lat in (-900_000_000, 900_000_000) for lon in (0, 1_800_000_000)]
    assert len(await areas(script, *edges, (BACK, -7.0, 2_000_000_000, 2_000_000_000))) == 4


@pytest.mark.parametrize(("number", "fits"), [(1000, True), (1001, False)])
@played(tell)
async def test_a_list_has_at_most_a_thousand_items(script: Fenced, *, number: int, fits: bool) -> None:
    asking = asyncio.ensure_future(
        areas(script, *[at(CIRCLE_OUT, 1.0, float(east)) for east in range(number)])
    )
    if fits:
        assert len(await asking) == 1000
        return
    with pytest.raises(AutopilotTimeout, match="the vehicle's fence has 1001 items, more than 1000"):
        await asking
    assert script.of_kind("MISSION_REQUEST_INT") == []


@played(tell)
async def test_a_list_has_ten_minutes(script: Fenced) -> None:
    script.takes_s = 0.9
    with pytest.raises(AutopilotTimeout, match="fence: not done within 600 s"):
        await areas(script, *[at(CIRCLE_OUT, 1.0, 0.0)] * 700)


@pytest.mark.parametrize(
    ("silent", "said"), [(None, "how many items it has of its fence"), (1, "item 1 of its fence")]
)
@played(tell)
async def test_a_question_about_the_list_is_asked_five_times(
    script: Fenced, *, silent: int | None, said: str
) -> None:
    script.silent = {silent}
    with pytest.raises(AutopilotTimeout, match=f"the vehicle did not tell {said}"):
        await areas(script, at(CIRCLE_OUT, 1.0, 0.0), at(CIRCLE_OUT, 1.0, 0.0))
    if silent is None:
        assert len(script.of_kind("MISSION_REQUEST_LIST")) == 5
    else:
        assert [message.seq for message in script.of_kind("MISSION_REQUEST_INT")] == [0, 1, 1, 1, 1, 1]


@played(tell)
async def test_answers_about_another_list_or_item_are_no_answers(script: Fenced) -> None:
    def others(message: Any) -> list[Any]:
        wrong = at(CIRCLE_OUT, 99.0, 0.0)
        if message.get_type() == "MISSION_REQUEST_LIST":
            return [count(7, MISSION), item(0, wrong)]
        seq = message.seq
        return [item(seq, wrong, MISSION), item(1 - seq, wrong), count(1)]

    script.also = others
    found = await areas(script, at(CIRCLE_OUT, 1.0, 0.0), at(CIRCLE_OUT, 2.0, 0.0))
    assert [area.radius_m for _, area, _ in found if isinstance(area, Circle)] == [1.0, 2.0]


# --- parameters ---------------------------------------------------------------------------------------------

HOME = mavlink.MAVLink_home_position_message(
    393_666_000, 229_507_000, 488_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0
)
COPTER_NAMES = FenceNames("FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN", "RTL_ALT")
ALL = {
    "FENCE_ENABLE": 1.0,
    "FENCE_AUTOENABLE": 0.0,
    "FENCE_TYPE": 11.0,  # ceiling, circle and floor
    "FENCE_RADIUS": 150.0,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ALT_MIN": 5.0,
    "FENCE_MARGIN": 3.0,
    "RTL_ALT": 9_900.0,
}


OF_PX4 = {
    "GF_ACTION": 3.0,
    "GF_MAX_HOR_DIST": 150.0,
    "GF_MAX_VER_DIST": 100.0,
    "GF_PREDICT": 0.0,
    "COM_OBL_RC_ACT": 3.0,
}


class FencedPx4(Px4Script, Fenced):
    """A PX4 with a list of areas."""


async def limits_of(
    parameters: dict[str, float], kind: type[Script], *, without: str = "", home: bool = True
) -> tuple[VehicleLimits, list[str]]:
    """The limits of a vehicle with these parameters, and the names of the settings that were told of its fence."""
    async with scripted(kind=kind) as script:
        script.parameters = {script.always_has: 1.0, **parameters}
        script.parameters.pop(without, None)
        if home:
            await script.say(HOME)
        limits = await script.autopilot.limits()
        settings = [news for news in script.news if isinstance(news, VehicleSetting)]
        return limits, [news.name for news in settings if news.name.startswith("GF_")]


@pytest.mark.parametrize(
    ("changed", "radius_m", "highest_m", "lowest_m", "returns_at_m"),
    [
        ({}, 150.0, 100.0, 5.0, 97.0),
        ({"RTL_ALT": 3_000.0}, 150.0, 100.0, 5.0, 30.0),
        ({"FENCE_TYPE": 10.0}, 150.0, None, 5.0, 99.0),
        ({"FENCE_TYPE": 9.0}, None, 100.0, 5.0, 97.0),
        ({"FENCE_TYPE": 3.0}, 150.0, 100.0, None, 97.0),
        ({"FENCE_RADIUS": 0.0}, None, 100.0, 5.0, 97.0),
        ({"FENCE_RADIUS": 0.5}, 0.5, 100.0, 5.0, 97.0),
        ({"FENCE_ENABLE": 0.0, "FENCE_AUTOENABLE": 2.0}, 150.0, 100.0, 5.0, 97.0),
    ],
)
@pytest.mark.virtual
async def test_the_parts_of_an_arducopters_fence_that_count(
    changed: dict[str, float],
    radius_m: float | None,
    highest_m: float | None,
    lowest_m: float | None,
    returns_at_m: float,
) -> None:
    limits, _ = await limits_of(ALL | changed, Script)
    radii = [fence.area.radius_m for fence in limits.fences if isinstance(fence.area, Circle)]
    assert radii == ([] if radius_m is None else [radius_m])
    assert (limits.highest_m, limits.lowest_m, limits.margin_m) == (highest_m, lowest_m, 3.0)
    assert limits.returns_at_m == pytest.approx(returns_at_m)
    assert (limits.names, limits.home_above_sea_m) == (COPTER_NAMES, 488.0)
    assert limits.untold == ()


@pytest.mark.virtual
async def test_a_fence_that_is_off_does_not_count() -> None:
    limits, _ = await limits_of(ALL | {"FENCE_ENABLE": 0.0}, Script)
    assert (limits.fences, limits.highest_m, limits.untold) == ((), None, ())
    limits, _ = await limits_of(OF_PX4 | {"GF_ACTION": 0.0}, Px4Script)
    assert (limits.fences, limits.highest_m, limits.untold) == ((), None, ())


@pytest.mark.parametrize(
    ("kind", "without", "home", "untold"),
    [
        (Script, "FENCE_ENABLE", True, ("FENCE_ENABLE",)),
        (Script, "FENCE_ALT_MAX", True, ("FENCE_ALT_MAX",)),
        (Script, "FENCE_RADIUS", True, ("FENCE_RADIUS",)),
        (Script, "FENCE_ALT_MIN", True, ("FENCE_ALT_MIN",)),
        (Script, "FENCE_TYPE", True, ("FENCE_TYPE",)),
        (Script, "FENCE_MARGIN", True, ()),
        (Script, "", False, ("its home",)),
        (Px4Script, "GF_ACTION", True, ("GF_ACTION",)),
        (FencedPx4, "GF_MAX_HOR_DIST", True, ("GF_MAX_HOR_DIST",)),
        (FencedPx4, "GF_MAX_VER_DIST", True, ("GF_MAX_VER_DIST",)),
    ],
)
@pytest.mark.virtual
async def test_what_a_vehicle_does_not_tell_of_its_fence_is_named(
    kind: type[Script], without: str, untold: tuple[str, ...], *, home: bool
) -> None:
    limits, _ = await limits_of(ALL if kind is Script else OF_PX4, kind, without=without, home=home)
    assert limits.untold == untold
    on = without not in ("FENCE_ENABLE", "FENCE_TYPE", "GF_ACTION")
    assert len(limits.fences) == (on and home and "RADIUS" not in without and "HOR_DIST" not in without)
    assert limits.highest_m == (100.0 if on and without not in ("FENCE_ALT_MAX", "GF_MAX_VER_DIST") else None)
    if without in ("FENCE_MARGIN", "FENCE_ALT_MIN"):
        assert (limits.margin_m, limits.lowest_m) == (
            (0.0, 5.0) if without == "FENCE_MARGIN" else (3.0, None)
        )


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, []),
        ({"GF_ACTION": 2.0}, ["GF_ACTION"]),
        ({"GF_ACTION": 2.0, "COM_OBL_RC_ACT": 5.0}, []),
        ({"GF_ACTION": 3.0, "COM_OBL_RC_ACT": 5.0, "GF_PREDICT": 1.0}, ["GF_PREDICT"]),
        (
            {"GF_ACTION": 2.0, "GF_PREDICT": 1.0, "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0},
            [],
        ),  # no fence
        ({"GF_ACTION": 2.0, "GF_MAX_HOR_DIST": 0.0}, ["GF_ACTION"]),
        ({"GF_ACTION": 2.0, "GF_MAX_VER_DIST": 0.0}, ["GF_ACTION"]),
    ],
)
@pytest.mark.virtual
async def test_a_px4s_fence_and_what_may_surprise_at_it(changed: dict[str, float], told: list[str]) -> None:
    parameters = OF_PX4 | changed
    limits, settings = await limits_of(parameters, FencedPx4)
    assert settings == told
    radii = [fence.area.radius_m for fence in limits.fences if isinstance(fence.area, Circle)]
    assert radii == ([150.0] if parameters["GF_MAX_HOR_DIST"] else [])
    assert limits.highest_m == (parameters["GF_MAX_VER_DIST"] or None)
    assert (limits.margin_m, limits.untold) == (1.0, ())


@pytest.mark.virtual
async def test_a_px4_that_does_not_know_its_home_has_no_fence_around_it() -> None:
    limits, _ = await limits_of(OF_PX4, FencedPx4, home=False)
    assert (limits.fences, limits.untold) == ([], ("its home",))
    limits, _ = await limits_of(OF_PX4 | {"GF_MAX_HOR_DIST": 0.0}, FencedPx4, home=False)
    assert limits.untold == ()
