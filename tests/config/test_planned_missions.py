"""A mission that flies a plan: what the configuration takes from it, and what keeps it on the ground."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests import events

from upwash import Drone
from upwash.config.drone import DroneConfig, MissionConfig
from upwash.config.drone_file import drone_config, read_drone_config
from upwash.config.places import altitudes_above_sea, ending, file_notices, geofence, waypoints
from upwash.config.values import HomeConfig
from upwash.core.geo import Position
from upwash.errors import AutopilotRefused, ConfigError
from upwash.lab.run import Run, simulate

PLANS = Path(__file__).parents[1] / "plans"
PLAN: dict[str, Any] = json.loads((PLANS / "field.plan").read_text())
LIST = (PLANS / "field.waypoints").read_text()
CONFIG = """
[mission]
plan = "field.plan"
{mission}
[[service]]
name = "detector"
local_call_s = {{ light = 3.0, heavy = 10.0 }}
"""


def written(tmp_path: Path, *, plan: str | dict[str, Any] = PLAN, mission: str = "") -> Path:
    content = plan if isinstance(plan, str) else json.dumps(plan)
    (tmp_path / "field.plan").write_text(content)
    file = tmp_path / "drone.toml"
    file.write_text(CONFIG.format(mission=mission))
    return file


def read(tmp_path: Path, **content: Any) -> DroneConfig:
    return read_drone_config(written(tmp_path, **content))


def planned(*, fence: dict[str, Any] | None = None, **moved: tuple[float, float]) -> dict[str, Any]:
    """The plan with another geofence, or items such as `item2` at other places."""
    plan: dict[str, Any] = json.loads(json.dumps(PLAN))
    if fence is not None:
        plan["geoFence"] = {"version": 2, "circles": [], "polygons": [], **fence}
    for name, place in moved.items():
        plan["mission"]["items"][int(name.removeprefix("item")) - 1]["params"][4:6] = place
    return plan


def test_what_the_configuration_leaves_out_comes_from_the_plan(tmp_path: Path, monkeypatch: Any) -> None:
    file = written(tmp_path)
    monkeypatch.chdir("/")  # the plan's path counts from the configuration's folder
    mission = read_drone_config(file).mission
    assert mission.home == HomeConfig(latitude_deg=39.3666, longitude_deg=22.9507)
    assert (mission.altitude_m, mission.ground_speed_m_s) == (20.0, 5.0)
    first, second, third = waypoints(mission)
    assert [each.index for each in (first, second, third)] == [0, 1, 2]
    assert [each.ground_speed_m_s for each in (first, second, third)] == [None, 2.5, 2.5]
    assert (first.position.east_m, first.position.altitude_m) == (0.0, 25.0)
    assert first.position.north_m == pytest.approx(111.02, abs=0.01)
    assert second.position.altitude_m == 30.0
    assert [fence.name for fence in geofence(mission)] == ["inclusion polygon 1", "exclusion circle 1"]
    assert ending(mission) == "return"


def test_what_the_configuration_names_counts_before_the_plan(tmp_path: Path) -> None:
    mission = read(tmp_path, mission="altitude_m = 7.0\nground_speed_m_s = 2.0").mission
    assert (mission.altitude_m, mission.ground_speed_m_s) == (7.0, 2.0)
    relative = LIST.replace("4\t0\t0\t16", "4\t0\t3\t16")
    moved = "home = { latitude_deg = 39.3676, longitude_deg = 22.9507 }"
    first = waypoints(read(tmp_path, plan=relative, mission=moved).mission)[0]
    assert first.position == Position(0.0, 0.0, 25.0)


def test_without_a_takeoff_the_drone_climbs_to_its_first_waypoint(tmp_path: Path) -> None:
    plan = json.loads(json.dumps(PLAN))
    del plan["mission"]["items"][0]
    assert read(tmp_path, plan=plan).mission.altitude_m == 25.0


def from_sea(mission: MissionConfig) -> tuple[int | None, float | None, float, float | None]:
    """The first item that counts from the sea; the altitude of home, the one converted with, that of the take-off."""
    plan = altitudes_above_sea(mission)
    assert plan is not None
    return (
        plan.above_sea_level,
        plan.home_above_sea_m,
        plan.reference_above_sea_m,
        plan.takeoff_above_sea_m,
    )


def test_altitudes_above_the_sea_stay_known_beside_the_plans_home(tmp_path: Path) -> None:
    mission = read(tmp_path, plan=LIST).mission
    assert [waypoint.above_sea_m for waypoint in waypoints(mission)] == [None, 130.0, None]
    assert from_sea(mission) == (4, 100, 100, None)
    assert altitudes_above_sea(read(tmp_path, plan=LIST.replace("\t0\t0\t16", "\t0\t3\t16")).mission) is None


def above_sea(*altitudes_m: float, home_m: float | None, takeoff: bool = False) -> str:
    """A list whose altitudes count from the sea; the first one is of a take-off if so wished."""
    rows = [
        (16, home_m or 0.0),
        *((22 if takeoff and not index else 16, altitude_m) for index, altitude_m in enumerate(altitudes_m)),
    ]
    lines = [
        f"{number} 0 0 {command} 0 0 0 0 39.3666 22.9507 {height_m} 1"
        for number, (command, height_m) in enumerate(rows)
    ]
    return "\n".join(["QGC WPL 110", *lines])


def test_an_altitude_of_home_that_the_plan_does_not_know_is_assumed(tmp_path: Path) -> None:
    mission = read(tmp_path, plan=above_sea(530, 540, home_m=None)).mission
    assert from_sea(mission) == (1, None, 510, 530)
    assert [waypoint.position.altitude_m for waypoint in waypoints(mission)] == [20, 30]
    assert mission.altitude_m == 20


def test_a_takeoff_above_the_sea_counts_unless_the_configuration_names_an_altitude(tmp_path: Path) -> None:
    plan = above_sea(530, 540, home_m=500, takeoff=True)
    found = [
        altitudes_above_sea(read(tmp_path, plan=plan, mission=line).mission)
        for line in ("", "altitude_m = 30.0")
    ]
    assert [each and each.takeoff_above_sea_m for each in found] == [530, None]


def test_a_plan_among_others_is_one_too_many(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found waypoints_m, plan"):
        read(tmp_path, mission="waypoints_m = [[0, 0]]")


def test_a_missing_plan_is_named(tmp_path: Path) -> None:
    file = written(tmp_path)
    (tmp_path / "field.plan").unlink()
    with pytest.raises(ConfigError, match="no such file") as refused:
        read_drone_config(file)
    assert refused.value.file == str(tmp_path / "field.plan")


def test_a_plan_without_home_needs_one_from_the_configuration(tmp_path: Path) -> None:
    homeless = LIST.replace("39.3666\t22.9507\t100", "0\t0\t0").replace("4\t0\t0\t16", "4\t0\t3\t16")
    with pytest.raises(ConfigError, match=r"mission\.home: missing, and .*field\.plan names none"):
        read(tmp_path, plan=homeless)
    home = "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }"
    assert len(waypoints(read(tmp_path, plan=homeless, mission=home).mission)) == 3


def test_altitudes_above_the_sea_need_no_home_in_the_plan(tmp_path: Path) -> None:
    homeless = LIST.replace("39.3666\t22.9507\t100", "0\t0\t0")
    home = "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }"
    mission = read(tmp_path, plan=homeless, mission=home).mission
    assert from_sea(mission) == (4, None, 110, None)


def square(*, north_deg: float) -> list[list[float]]:
    return [[39.3656, 22.9497], [north_deg, 22.9497], [north_deg, 22.9557], [39.3656, 22.9557]]


REFUSED = [
    # the plan, more of the configuration, where, what the message has to name
    (planned(item2=(39.3756, 22.9507)), "", "item 2", "waypoint 0 is outside inclusion polygon 1"),
    (planned(item5=(39.3676, 22.9527)), "", "item 5", "waypoint 2 is within exclusion circle 1"),
    (
        planned(item2=(39.3676, 22.9517), item4=(39.3676, 22.9537)),
        "",
        "item 4",
        "the straight way from waypoint 0 to waypoint 1 crosses exclusion circle 1",
    ),
    (
        planned(
            fence={"polygons": [{"inclusion": True, "polygon": square(north_deg=39.3660), "version": 1}]}
        ),
        "",
        "plannedHomePosition",
        "home is outside inclusion polygon 1",
    ),
    (
        planned(
            fence={
                "circles": [
                    {"circle": {"center": [39.3671, 22.9507], "radius": 9}, "inclusion": False, "version": 1}
                ]
            }
        ),
        "",
        "item 2",
        "the straight way from home to waypoint 0 crosses exclusion circle 1",
    ),
    (planned(fence={}, item5=(41.0, 22.9527)), "", "item 5", "waypoint 2 is 181 km from home"),
    (
        PLAN,
        "home = { latitude_deg = 39.3667, longitude_deg = 22.9507 }",
        "item 4",
        "mission.home is not the plan's home",
    ),
]


@pytest.mark.parametrize(("plan", "mission", "where", "named"), REFUSED)
def test_a_plan_that_cannot_be_flown_is_refused_before_take_off(
    tmp_path: Path, plan: dict[str, Any], mission: str, where: str, named: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, plan=plan, mission=mission)
    assert refused.value.file == str(tmp_path / "field.plan")
    assert (refused.value.key, named in refused.value.problem) == (where, True), refused.value.problem


def test_a_way_around_a_corner_of_the_field_is_refused(tmp_path: Path) -> None:
    concave = [[39.3656, 22.9497], [39.3696, 22.9497], [39.3696, 22.9515], [39.3670, 22.9515],
               [39.3670, 22.9520], [39.3696, 22.9520], [39.3696, 22.9557], [39.3656, 22.9557]]  # fmt: skip
    plan = planned(fence={"polygons": [{"inclusion": True, "polygon": concave, "version": 1}]})
    with pytest.raises(ConfigError, match="from waypoint 1 to waypoint 2 leaves inclusion polygon 1"):
        read(tmp_path, plan=plan)


def test_what_is_left_out_of_a_plan_is_said_with_its_file(tmp_path: Path) -> None:
    plan = json.loads(json.dumps(PLAN))
    plan["mission"]["items"][1]["params"][1] = 5
    (notice,) = file_notices(read(tmp_path, plan=plan))
    assert notice.startswith(
        f"{tmp_path}/field.plan: item 2: MAV_CMD_NAV_WAYPOINT (16): its acceptance radius"
    )
    assert file_notices(read(tmp_path)) == []


# --- flown on virtual time ----------------------------------------------------------------------------------


def here(mission: Any) -> str:
    return f'program = "{__file__}:{mission.__name__}"'


def event(run: Run, name: str) -> dict[str, Any]:
    return next(event for event in events.written(run.events) if event["event"] == name)


def test_a_plan_is_flown_as_it_says(tmp_path: Path) -> None:
    run = simulate(read(tmp_path))
    assert (run.failure, run.result.waypoints, run.result.undone) == ("", 3, [])
    assert event(run, "took_off")["altitude_m"] == 20.0
    legs = {each["waypoint"]: each["t"] for each in events.written(run.events) if each["event"] == "leg"}
    arrivals = {
        each["waypoint"]: each["t"] for each in events.written(run.events) if each["event"] == "arrived"
    }
    # 111 m north of home at 5 m/s, another 111 m at 2.5 m/s, and the time to speed up and brake at 1 m/s²
    assert arrivals[0] - legs[0] == pytest.approx(111.1 / 5 + 5, abs=0.1)
    assert arrivals[1] - legs[1] == pytest.approx(111.1 / 2.5 + 2.5, abs=0.1)


def test_a_hold_is_flown_after_the_arrival_and_before_the_calls(tmp_path: Path) -> None:
    plan = json.loads(json.dumps(PLAN))
    plan["mission"]["items"][1]["params"][0] = 7.5
    plain, held = simulate(read(tmp_path)), simulate(read(tmp_path, plan=plan))
    assert event(held, "arrived")["hold_s"] == 7.5
    assert event(held, "photo")["t"] - event(plain, "photo")["t"] == pytest.approx(7.5)
    assert held.result.mission_time_s - plain.result.mission_time_s == pytest.approx(7.5, abs=0.1)


def test_a_plan_that_lands_at_its_end_does_not_return(tmp_path: Path) -> None:
    plan = json.loads(json.dumps(PLAN))
    plan["mission"]["items"][5].update(command=21, frame=3, params=[0, 0, 0, None, 39.3686, 22.9527, 0])
    run = simulate(read(tmp_path, plan=plan))
    assert run.failure == ""
    assert "returning" not in [each["event"] for each in events.written(run.events)]
    assert event(run, "landing")["t"] < event(run, "landed")["t"]


def stray(drone: Drone) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(10)
    drone.autopilot.goto(Position(0.0, 100.0, 20.0))
    before = drone.autopilot.position
    for outside in (
        Position(0.0, -500.0, 20.0),
        Position(172.0, 111.0, 20.0),  # in the circle
        Position(300.0, 122.0, 20.0),  # behind it
    ):
        with pytest.raises(AutopilotRefused, match="geofence"):
            drone.autopilot.goto(outside)
        assert drone.autopilot.position == before
    drone.autopilot.goto(Position(100.0, 0.0, 20.0))
    drone.autopilot.return_home_and_land()


def test_a_mission_cannot_leave_the_geofence(tmp_path: Path) -> None:
    assert simulate(read(tmp_path, mission=here(stray))).failure == ""


# --- whatever happens to a plan -----------------------------------------------------------------------------


def numbers(value: object, way: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    match value:
        case dict():
            return [place for name, each in value.items() for place in numbers(each, (*way, name))]
        case list():
            return [place for index, each in enumerate(value) for place in numbers(each, (*way, index))]
        case int() | float():
            return [way]
    return []


@settings(max_examples=200, deadline=None)
@given(data=st.data(), changes=st.integers(1, 3))
def test_a_plan_with_other_numbers_is_refused_or_lies_within_its_fences(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, changes: int
) -> None:
    plan = json.loads(json.dumps(PLAN))
    for _ in range(changes):
        *way, last = data.draw(st.sampled_from(numbers(plan)))
        parent = plan
        for step in way:
            parent = parent[step]
        parent[last] = data.draw(
            st.floats() | st.just(parent[last]).map(lambda value: value * 1.00001) | st.integers(-5, 5)
        )
    folder = tmp_path_factory.getbasetemp()
    (folder / "field.plan").write_text(json.dumps(plan))
    try:
        config = drone_config(tomllib.loads(CONFIG.format(mission="")), folder / "drone.toml")
    except ConfigError as refused:
        assert refused.problem
        return
    assert all(
        fence.allows(waypoint.position)
        for fence in geofence(config.mission)
        for waypoint in waypoints(config.mission)
    )
