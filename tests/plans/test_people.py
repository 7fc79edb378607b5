"""Plans as people make them: what is flown, and what is left out with a notice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from upwash.core.geo import GeoPosition
from upwash.errors import ConfigError
from upwash.plans import FlightPlan, read_plan

FOLDER = Path(__file__).parent
LIST = (FOLDER / "field.waypoints").read_text()
NORTH = (39.3676, 22.9507)


def row(
    command: int,
    *parameters: float,
    place: tuple[float, float] = (0, 0),
    altitude_m: float = 0,
    frame: int = 3,
) -> str:
    """A line of a list without its number."""
    four = [*parameters, 0, 0, 0, 0][:4]
    return f"0\t{frame}\t{command}\t" + "\t".join(str(each) for each in (*four, *place, altitude_m)) + "\t1"


HOME = row(16, place=(39.3666, 22.9507), altitude_m=100, frame=0)
TAKEOFF = row(22, altitude_m=20)
FIRST = row(16, place=NORTH, altitude_m=25)
SECOND = row(16, place=(39.3686, 22.9507), altitude_m=30)
RETURN = row(20)


def listed(*rows: str) -> str:
    return "\n".join(["QGC WPL 110", *(f"{number}\t{each}" for number, each in enumerate(rows))])


def read(tmp_path: Path, *rows: str) -> FlightPlan:
    file = tmp_path / "people.waypoints"
    file.write_text(listed(*rows))
    return read_plan(file)


def refusal(tmp_path: Path, *rows: str) -> str:
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, *rows)
    return f"{refused.value.key}: {refused.value.problem}"


def told(plan: FlightPlan) -> list[str]:
    return [str(notice) for notice in plan.notices]


# --- left out, and told -------------------------------------------------------------------------------------

PHOTOS = "left out: the mission takes its photos itself"
FILM = "left out: it films, and the mission takes photos"
SHOOT = row(203, place=(1, 0))  # parameter 5
AIM = "left out: the flight points no camera"
LEFT_OUT = [
    # the item, and what is told of it
    (SHOOT, f"MAV_CMD_DO_DIGICAM_CONTROL (203): {PHOTOS}"),
    (
        row(203),
        "MAV_CMD_DO_DIGICAM_CONTROL (203): left out: it takes no photo, as its parameter 5 (shoot) is 0, not 1",
    ),
    (row(214, 2000), f"MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL (214): {PHOTOS}"),
    (
        row(214),
        "MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL (214): left out: a time of 0 ms (parameter 1) changes nothing",
    ),
    (row(260, 12.5), f"MAV_CMD_OBLIQUE_SURVEY (260): {PHOTOS}"),
    (row(2003, 1), f"MAV_CMD_DO_TRIGGER_CONTROL (2003): {PHOTOS}"),
    (row(2003, -1, 1, -1), "MAV_CMD_DO_TRIGGER_CONTROL (2003): left out: it neither starts nor ends photos"),
    (row(206, 12.5), f"MAV_CMD_DO_SET_CAM_TRIGG_DIST (206): {PHOTOS}"),
    (row(530, 0, 2), f"MAV_CMD_SET_CAMERA_MODE (530): {PHOTOS}"),
    (row(2000, 0, 2), f"MAV_CMD_IMAGE_START_CAPTURE (2000): {PHOTOS}"),
    (row(2001), f"MAV_CMD_IMAGE_STOP_CAPTURE (2001): {PHOTOS}"),
    (row(2500), f"MAV_CMD_VIDEO_START_CAPTURE (2500): {FILM}"),
    (row(2501), f"MAV_CMD_VIDEO_STOP_CAPTURE (2501): {FILM}"),
    (row(195, place=NORTH), f"MAV_CMD_DO_SET_ROI_LOCATION (195): {AIM}"),
    (row(197), f"MAV_CMD_DO_SET_ROI_NONE (197): {AIM}"),
    (row(201, 3, place=NORTH), f"MAV_CMD_DO_SET_ROI (201): {AIM}"),
    (row(205, -90), f"MAV_CMD_DO_MOUNT_CONTROL (205): {AIM}"),
    (row(1000, -90), f"MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW (1000): {AIM}"),
    (row(115, 90, 10, 1), "MAV_CMD_CONDITION_YAW (115): left out: the vehicle turns its nose"),
    (row(189), "MAV_CMD_DO_LAND_START (189): left out: it marks a place"),
    (row(207, 0), "MAV_CMD_DO_FENCE_ENABLE (207): left out: the vehicle's own fence stays on"),
    (row(178, 2, 1), "MAV_CMD_DO_CHANGE_SPEED (178): left out: the vehicle climbs and sinks"),
]


@pytest.mark.parametrize(("item", "what"), LEFT_OUT)
def test_what_no_flight_needs_is_left_out_and_told(tmp_path: Path, item: str, what: str) -> None:
    plain = read(tmp_path, HOME, TAKEOFF, FIRST, SECOND, RETURN)
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, item, SECOND, RETURN)
    assert [waypoint.place for waypoint in plan.waypoints] == [waypoint.place for waypoint in plain.waypoints]
    assert [waypoint.item for waypoint in plan.waypoints] == [2, 4]
    (notice,) = told(plan)
    assert notice.startswith(f"item 3: {what}")
    assert told(plain) == []


def test_what_is_said_of_several_items_is_said_once(tmp_path: Path) -> None:
    (notice,) = told(read(tmp_path, HOME, TAKEOFF, FIRST, SHOOT, SHOOT, SECOND, SHOOT))
    assert notice.startswith("items 3-4, 6: MAV_CMD_DO_DIGICAM_CONTROL")
    (notice,) = told(read(tmp_path, HOME, TAKEOFF, *[FIRST, SHOOT] * 10))
    assert notice.startswith("items 3 to 21 (10 of them): MAV_CMD_DO_DIGICAM_CONTROL")


def test_what_comes_after_the_end_may_be_left_out_too(tmp_path: Path) -> None:
    assert read(tmp_path, HOME, TAKEOFF, FIRST, RETURN, row(2001)).ending == "return"
    assert "after the plan's return" in refusal(tmp_path, HOME, TAKEOFF, FIRST, RETURN, SECOND)


@pytest.mark.parametrize(("index", "what"), [(2, "acceptance radius"), (3, "pass radius"), (4, "heading")])
def test_how_a_waypoint_is_passed_is_left_out_and_told(tmp_path: Path, index: int, what: str) -> None:
    parameters = [0.0, 0.0, 0.0, 0.0]
    parameters[index - 1] = 45
    (notice,) = told(read(tmp_path, HOME, TAKEOFF, row(16, *parameters, place=NORTH, altitude_m=25)))
    assert notice.startswith(f"item 2: MAV_CMD_NAV_WAYPOINT (16): its {what} is left out")


# --- flown --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(0, 0), (float("nan"), float("nan"))])
def test_a_takeoff_needs_no_place(tmp_path: Path, place: tuple[float, float]) -> None:
    plan = read(tmp_path, HOME, row(22, place=place, altitude_m=20), FIRST)
    assert (plan.takeoff_altitude_m, told(plan)) == (20, [])


def test_a_takeoff_elsewhere_is_flown_where_the_vehicle_stands(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, row(22, place=(39.3669, 22.9507), altitude_m=20), FIRST)
    assert plan.takeoff_altitude_m == 20
    assert [waypoint.item for waypoint in plan.waypoints] == [2]
    (notice,) = told(plan)
    assert "33 m from the plan's home, is left out: the vehicle climbs where it stands" in notice


def test_the_takeoffs_place_is_home_where_the_plan_knows_none(tmp_path: Path) -> None:
    takeoff = row(22, place=NORTH, altitude_m=20)
    nowhere, far_away = row(16, frame=0), row(16, place=(-35.363, 149.165), altitude_m=584, frame=0)
    for home in (nowhere, far_away):
        plan = read(tmp_path, home, takeoff, SECOND)
        assert plan.home == GeoPosition(*NORTH)
        assert plan.home_above_sea_m is None
        assert (
            "the take-off's place is taken for it" in told(plan)[0]
            or "place of its take-off" in told(plan)[0]
        )
    assert read(tmp_path, nowhere, TAKEOFF, SECOND).home is None


def test_a_list_that_begins_with_its_takeoff_has_no_home(tmp_path: Path) -> None:
    plan = read(tmp_path, row(22, place=NORTH, altitude_m=10), FIRST, SECOND)
    assert ([waypoint.item for waypoint in plan.waypoints], plan.takeoff_altitude_m) == ([1, 2], 10)
    assert told(plan)[0] == "it has no item for home: every item is flown"


def test_a_list_of_waypoints_alone_has_no_home(tmp_path: Path) -> None:
    plan = read(tmp_path, FIRST, SECOND)
    assert ([waypoint.item for waypoint in plan.waypoints], plan.home) == ([0, 1], None)
    assert told(plan) == ["it has no item for home: every item is flown"]
    file = tmp_path / "from-one.waypoints"
    file.write_text(listed(HOME, FIRST, SECOND).replace(f"0\t{HOME}\n", ""))
    plan = read_plan(file)
    assert ([waypoint.item for waypoint in plan.waypoints], plan.home) == ([1, 2], None)


def test_in_a_list_an_altitude_or_a_place_of_0_is_the_one_before(tmp_path: Path) -> None:
    ground, nowhere = row(16, place=(39.3686, 22.9507)), row(16, 3)
    plan = read(tmp_path, HOME, TAKEOFF, ground, nowhere, FIRST, nowhere, RETURN)
    assert [(waypoint.item, waypoint.place.altitude_m, waypoint.hold_s) for waypoint in plan.waypoints] == [
        (2, 20, 3),
        (4, 25, 3),
    ]
    assert [notice.split(":")[0] for notice in told(plan)] == ["item 2", "items 3, 5"]
    assert "has no place" in refusal(tmp_path, HOME, nowhere)
    assert "lies 0 m above home" in refusal(tmp_path, HOME, ground)


@pytest.mark.parametrize("command", [16, 82, 19])
def test_a_hold_time_is_flown(tmp_path: Path, command: int) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(command, 7.5, place=NORTH, altitude_m=25), SECOND)
    assert [waypoint.hold_s for waypoint in plan.waypoints] == [7.5, 0]


def test_a_spline_is_flown_straight(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(82, place=NORTH, altitude_m=25))
    assert plan.waypoints[0].place == GeoPosition(*NORTH, 25)
    assert told(plan) == [
        "item 2: MAV_CMD_NAV_SPLINE_WAYPOINT (82): flown to on a straight line, not on a curve"
    ]


def test_delays_are_hovers_at_the_waypoint_before(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(93, 9), FIRST, row(93, 5), row(112, 3), row(19, 2), SECOND)
    assert [(waypoint.item, waypoint.hold_s) for waypoint in plan.waypoints] == [(3, 10), (7, 0)]
    assert [notice.split(":")[0] for notice in told(plan)] == ["item 2", "item 5"]


def test_a_hold_without_a_place_at_another_altitude_is_a_waypoint(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, row(19, 4, altitude_m=40))
    assert [(waypoint.place.altitude_m, waypoint.hold_s) for waypoint in plan.waypoints] == [(25, 0), (40, 4)]
    assert plan.waypoints[1].place.latitude_deg == NORTH[0]
    first = read(tmp_path, HOME, TAKEOFF, row(19, 4), FIRST).waypoints[0]
    assert (first.place, first.hold_s) == (GeoPosition(39.3666, 22.9507, 20), 4)


def test_a_landing_elsewhere_is_a_waypoint_above_it(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, row(21, place=(39.3686, 22.9527)))
    assert plan.ending == "land"
    assert plan.waypoints[-1].place == GeoPosition(39.3686, 22.9527, 25)
    assert told(plan)[0].startswith("item 3: MAV_CMD_NAV_LAND (21): flown as a waypoint above its place")


def test_a_landing_in_a_list_ends_on_the_ground_whatever_its_altitude(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, row(21, place=NORTH, altitude_m=30))
    assert (plan.ending, len(plan.waypoints)) == ("land", 1)
    assert told(plan) == [
        "item 3: MAV_CMD_NAV_LAND (21): its altitude is left out: a landing ends on the ground"
    ]


def test_a_return_goes_home_whatever_its_place(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, row(20, place=NORTH, altitude_m=30))
    assert (plan.ending, len(plan.waypoints)) == ("return", 1)
    assert "a return goes to the vehicle's home" in told(plan)[0]


@pytest.mark.parametrize("end", [RETURN, row(21)])
def test_a_speed_before_the_end_changes_nothing(tmp_path: Path, end: str) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, FIRST, row(178, 1, 3), end)
    assert [waypoint.ground_speed_m_s for waypoint in plan.waypoints] == [None]
    assert told(plan) == [
        "item 3: MAV_CMD_DO_CHANGE_SPEED (178): left out: no waypoint comes after it, and the end has its own speed"
    ]


@pytest.mark.parametrize(
    ("speed_m_s", "flown_m_s", "what"),
    [
        (-1, 5, "left out: a speed of -1 changes nothing"),
        (-2, None, "a speed of -2 is flown as the speed of the mission"),
    ],
)
def test_a_speed_may_be_no_change_or_the_default(
    tmp_path: Path, speed_m_s: float, flown_m_s: float | None, what: str
) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(178, 1, 5), FIRST, row(178, 1, speed_m_s), SECOND, RETURN)
    assert [waypoint.ground_speed_m_s for waypoint in plan.waypoints] == [5, flown_m_s]
    assert told(plan) == [f"item 4: MAV_CMD_DO_CHANGE_SPEED (178): {what}"]
    assert read(tmp_path, HOME, TAKEOFF, FIRST, row(178, 1, speed_m_s), RETURN).ending == "return"


@pytest.mark.parametrize("throttle", [0, -1, -2, 60])
def test_a_throttle_is_left_out(tmp_path: Path, throttle: float) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(178, 1, 5, throttle), FIRST)
    assert plan.waypoints[0].ground_speed_m_s == 5
    assert len(told(plan)) == (throttle == 60)


def test_a_speed_of_nothing_is_refused(tmp_path: Path) -> None:
    for speed_m_s in (0, -3, 101):
        assert "expected a speed above 0" in refusal(tmp_path, HOME, TAKEOFF, row(178, 1, speed_m_s), FIRST)


def test_an_airspeed_is_a_ground_speed(tmp_path: Path) -> None:
    plan = read(tmp_path, HOME, TAKEOFF, row(178, 0, 4), FIRST)
    assert plan.waypoints[0].ground_speed_m_s == 4
    assert "an airspeed is flown as a ground speed" in told(plan)[0]


def test_a_list_with_items_taken_out_is_flown_in_its_order(tmp_path: Path) -> None:
    file = tmp_path / "gap.waypoints"
    file.write_text(listed(HOME, TAKEOFF, FIRST, SECOND).replace("\n3\t", "\n8\t"))
    plan = read_plan(file)
    assert [waypoint.item for waypoint in plan.waypoints] == [2, 8]
    assert "its numbers leave item 3 out" in told(plan)[0]


def test_comments_in_a_list_are_skipped(tmp_path: Path) -> None:
    file = tmp_path / "comments.waypoints"
    file.write_text(listed(HOME, TAKEOFF, FIRST).replace("\n1\t", "\n# the take-off\n1\t"))
    assert [waypoint.item for waypoint in read_plan(file).waypoints] == [2]


def test_a_list_of_which_no_item_continues_by_itself_is_flown_on(tmp_path: Path) -> None:
    file = tmp_path / "waits.waypoints"
    file.write_text(
        "\n".join(line[:-1] + "0" if "\t" in line else line for line in listed(HOME, FIRST).splitlines())
    )
    assert "none of its items continues by itself" in told(read_plan(file))[0]


@pytest.mark.parametrize("home", [row(0, frame=0), row(179, place=NORTH), row(16, place=NORTH)])
def test_home_is_written_in_several_ways(tmp_path: Path, home: str) -> None:
    plan = read(tmp_path, home, TAKEOFF, SECOND)
    assert plan.home == (None if "39" not in home else GeoPosition(*NORTH))
    assert plan.home_above_sea_m is None


def test_an_altitude_below_home_names_both_altitudes(tmp_path: Path) -> None:
    low = row(16, place=NORTH, altitude_m=90, frame=0)
    assert "-10 m above home (90 m above the sea, and home at 100 m)" in refusal(tmp_path, HOME, low)


# --- QGroundControl's patterns ------------------------------------------------------------------------------


def simple(command: int, *parameters: Any, frame: int = 3) -> dict[str, Any]:
    seven = [*parameters, *[0] * 7][:7]
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": seven, "autoContinue": True}


def pattern(*items: dict[str, Any], kind: str = "survey") -> dict[str, Any]:
    return {
        "type": "ComplexItem",
        "complexItemType": kind,
        "TransectStyleComplexItem": {"Items": list(items)},
    }


def plan_of(tmp_path: Path, *items: dict[str, Any], **changes: Any) -> FlightPlan:
    document = json.loads((FOLDER / "field.plan").read_text())
    document["mission"]["items"] = list(items)
    document["mission"] |= changes
    document["geoFence"] = {"version": 2}
    file = tmp_path / "people.plan"
    file.write_text(json.dumps(document))
    return read_plan(file)


TURN = simple(16, 0, 0, 0, None, *NORTH, 25)


@pytest.mark.parametrize("kind", ["survey", "CorridorScan"])
def test_a_pattern_is_flown_as_its_single_waypoints(tmp_path: Path, kind: str) -> None:
    transects = pattern(TURN, simple(206, 12, frame=2), TURN, simple(206, 0, frame=2), kind=kind)
    plan = plan_of(tmp_path, simple(22, 0, 0, 0, None, 0, 0, 15), transects, TURN)
    assert [waypoint.item for waypoint in plan.waypoints] == [2, 4, 6]  # numbered as QGroundControl does
    assert told(plan) == [
        f"{kind} is flown as its 4 single commands, items 2-5",
        f"items 3, 5: MAV_CMD_DO_SET_CAM_TRIGG_DIST (206): {PHOTOS}, at each waypoint; with mission.photos = {{}} "
        "the plan's triggers take them in flight",
    ]


def test_a_survey_as_it_is_saved_is_flown() -> None:
    plan = read_plan(FOLDER / "survey.plan")
    assert [waypoint.item for waypoint in plan.waypoints] == [3, 5, 6, 7, 9, 10]
    assert [waypoint.place.altitude_m for waypoint in plan.waypoints] == [25, 25, 25, 25, 30, 20]
    assert [waypoint.hold_s for waypoint in plan.waypoints] == [0, 0, 0, 0, 8, 2]
    assert (plan.takeoff_altitude_m, plan.home_above_sea_m, plan.waypoints[-1].above_sea_m) == (20, None, 130)
    assert len(plan.notices) == 4


@pytest.mark.parametrize(
    "item",
    [pattern(), pattern(kind="StructureScan"), {"type": "ComplexItem", "complexItemType": "StructureScan"}],
)
def test_a_pattern_without_waypoints_names_the_way_round(tmp_path: Path, item: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"upload the plan to a vehicle.*download it again") as refused:
        plan_of(tmp_path, TURN, item)
    assert refused.value.key == "item 2"


def test_the_name_of_a_pattern_is_written_without_control_characters(tmp_path: Path) -> None:
    assert told(plan_of(tmp_path, pattern(TURN, kind="\x1b[2J" + "x" * 500)))[0].startswith("\\x1b[2Jxxx")
    assert len(told(plan_of(tmp_path, pattern(TURN, kind="x" * 500)))[0]) < 120


def test_patterns_count_towards_the_most_items(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="more than 10000 items"):
        plan_of(tmp_path, pattern(*[TURN] * 6_000), pattern(*[TURN] * 6_000))


def test_a_pattern_within_a_pattern_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="within a pattern"):
        plan_of(tmp_path, pattern(TURN, pattern(TURN)))


@pytest.mark.parametrize("home", [None, [0, 0, 0], [None, None, None]])
def test_a_plan_may_name_no_home(tmp_path: Path, home: Any) -> None:
    assert plan_of(tmp_path, TURN, plannedHomePosition=home).home is None


@pytest.mark.parametrize("altitude_m", [None, 0])
def test_the_altitude_of_home_may_be_unknown(tmp_path: Path, altitude_m: float | None) -> None:
    plan = plan_of(tmp_path, TURN, plannedHomePosition=[39.3666, 22.9507, altitude_m])
    assert (plan.home, plan.home_above_sea_m, told(plan)) == (GeoPosition(39.3666, 22.9507), None, [])


def test_what_is_assumed_of_an_unknown_altitude_is_told(tmp_path: Path) -> None:
    above_sea = simple(16, 0, 0, 0, None, *NORTH, 530, frame=0)
    plan = plan_of(
        tmp_path, simple(22, 0, 0, 0, None, 0, 0, 15), above_sea, plannedHomePosition=[39.3666, 22.9507, 0]
    )
    assert plan.waypoints[0].place.altitude_m == 15  # as high as the take-off
    assert told(plan)[0].startswith("item 2: its altitude counts from the sea")
    assert "home is assumed to lie 515 m high" in told(plan)[0]


def test_the_geofence_of_an_older_ground_station_is_one_to_stay_in(tmp_path: Path) -> None:
    document = json.loads((FOLDER / "field.plan").read_text())
    corners = [[39.3656, 22.9497], [39.3696, 22.9497], [39.3696, 22.9557]]
    document["geoFence"] = {"version": 1, "polygon": corners}
    file = tmp_path / "older.plan"
    file.write_text(json.dumps(document))
    (fence,) = read_plan(file).fences
    assert (fence.name, fence.inclusion) == ("inclusion polygon 1", True)


def test_a_plan_of_a_fence_alone_says_so(tmp_path: Path) -> None:
    document = json.loads((FOLDER / "field.plan").read_text())
    document["mission"]["items"] = []
    file = tmp_path / "fence.plan"
    file.write_text(json.dumps(document))
    with pytest.raises(ConfigError, match="has a geofence and no waypoint in it"):
        read_plan(file)
