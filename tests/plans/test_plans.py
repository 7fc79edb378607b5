"""Plans of ground stations: what is understood, and that nothing else is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from upwash.core.geo import GeoPosition
from upwash.errors import ConfigError
from upwash.plans import FlightPlan, PlannedCircle, PlannedWaypoint, read_plan

FOLDER = Path(__file__).parent
PLAN = (FOLDER / "field.plan").read_text()
LIST = (FOLDER / "field.waypoints").read_text()
HOME = GeoPosition(39.3666, 22.9507)

Table = dict[str, Any]


def refusal(tmp_path: Path, content: str | bytes) -> ConfigError:
    file = tmp_path / "some.plan"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as raised:
        read_plan(file)
    assert raised.value.file == str(file)
    return raised.value


def read(tmp_path: Path, content: str) -> FlightPlan:
    file = tmp_path / "some.plan"
    file.write_text(content)
    return read_plan(file)


# --- what is understood -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["field.plan", "field.waypoints"])
def test_both_formats_say_the_same_of_a_flight(name: str) -> None:
    plan = read_plan(FOLDER / name)
    assert plan.home == HOME
    assert plan.waypoints == (
        PlannedWaypoint(2, GeoPosition(39.3676, 22.9507, 25.0), None),
        PlannedWaypoint(
            4, GeoPosition(39.3686, 22.9507, 30.0), 2.5, 130.0
        ),  # above the sea, with home at 100 m
        PlannedWaypoint(5, GeoPosition(39.3686, 22.9527, 30.0), 2.5),
    )
    assert (plan.takeoff_altitude_m, plan.ending, plan.above_sea_level) == (20.0, "return", 4)


def test_a_plan_has_a_speed_and_a_geofence_too() -> None:
    plan = read_plan(FOLDER / "field.plan")
    assert plan.ground_speed_m_s == 5.0
    polygon, circle = plan.fences
    assert (polygon.name, polygon.inclusion) == ("inclusion polygon 1", True)
    assert circle == PlannedCircle("exclusion circle 1", False, GeoPosition(39.3676, 22.9527), 20.0)


def test_a_list_has_neither() -> None:
    plan = read_plan(FOLDER / "field.waypoints")
    assert (plan.ground_speed_m_s, plan.fences) == (None, ())


@pytest.mark.parametrize(
    "text",
    [
        LIST.replace("\t", "  "),
        LIST.replace("\n", "\r\n"),
        LIST.replace("\n", "\n\n"),
        "\ufeff" + LIST,
        LIST.replace("39.3676", "3.93676e1"),
    ],
)
def test_a_list_may_be_written_in_many_ways(tmp_path: Path, text: str) -> None:
    assert read(tmp_path, text) == read_plan(FOLDER / "field.waypoints")


def test_home_at_0_0_is_left_open(tmp_path: Path) -> None:
    text = LIST.replace("16\t0\t0\t0\t0\t39.3666\t22.9507\t100", "16\t0\t0\t0\t0\t0\t0\t0")
    assert read(tmp_path, text.replace("4\t0\t0\t16", "4\t0\t3\t16")).home is None


@pytest.mark.parametrize("place", ["39.3686\t22.9527\t0", "0\t0\t0"])
def test_a_landing_below_the_last_waypoint_ends_the_flight_there(tmp_path: Path, place: str) -> None:
    landing = f"6\t0\t3\t21\t0\t0\t0\t0\t{place}\t1"
    assert read(tmp_path, LIST.replace("6\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1", landing)).ending == "land"


def test_without_a_return_a_flight_still_returns(tmp_path: Path) -> None:
    assert read(tmp_path, "\n".join(LIST.splitlines()[:-1])).ending == "return"


# --- what is refused ----------------------------------------------------------------------------------------


def item(number: int, **changes: Any) -> Any:
    """Changes to one item."""
    return lambda document: document["mission"]["items"][number - 1].update(changes)


def parameter(number: int, index: int, value: Any) -> Any:
    """A change to one parameter, counted from 1, of an item."""

    def change(document: Table) -> None:
        document["mission"]["items"][number - 1]["params"][index - 1] = value

    return change


def mission(**changes: Any) -> Any:
    return lambda document: document["mission"].update(changes)


def fence(**changes: Any) -> Any:
    return lambda document: document["geoFence"].update(changes)


def circle(radius: float = 5.0, latitude_deg: float = 39.0, version: int = 1) -> list[Table]:
    shape = {"center": [latitude_deg, 22.0], "radius": radius}
    return [{"circle": shape, "inclusion": True, "version": version}]


SURVEY = {"type": "ComplexItem", "complexItemType": "survey"}
REFUSED_PLANS = [
    # the change, where, what the message has to name
    (item(2, **SURVEY), "item 2", "ComplexItem (survey)"),
    (item(2, type="Mystery"), "item 2", "Mystery"),
    (item(2, type=None), "item 2", "without a type"),
    (item(2, command=177), "item 2", "MAV_CMD_DO_JUMP (177)"),
    (item(2, command=17), "item 2", "end the plan with Return To Launch or Land"),
    (item(2, command=18), "item 2", "an obstacle may stand"),
    (item(2, command=84), "item 2", "for a VTOL"),
    (item(2, command=93, params=[-1, 12, 0, 0, 0, 0, 0]), "item 2", "waits for a time of day"),
    (item(2, command=179), "item 2", "moves the place of the return"),
    (item(2, command=183), "item 2", "drone.payload"),
    (item(2, command=207, params=[1, 0, 0, 0, 0, 0, 0]), "item 2", "FENCE_ENABLE"),
    (item(2, command=211), "item 2", "moves something"),
    (item(2, command=60_000), "item 2", "an unknown command (60000) is not"),
    (item(2, command="16"), "item 2", "`$.command`"),
    (item(2, frame=10), "item 2", "has frame 10, which"),
    (item(2, frame=11), "item 2", "altitude of 25 m from the terrain"),
    (item(1, frame=4), "item 1", "has frame 4, which"),
    (item(2, autoContinue=False), "item 2", "autoContinue"),
    (item(2, autoContinue=None), "item 2", "`$.autoContinue`"),
    (item(2, params=[0, 0, 0, 0]), "item 2", "`$.params`"),
    (item(2, params=None), "item 2", "`$.params`"),
    (parameter(2, 1, 3601), "item 2", "holds for 3601 s: expected 0 to 3600 s"),
    (parameter(2, 1, -1), "item 2", "holds for -1 s"),
    (parameter(2, 1, float("inf")), "item 2", "holds for inf s"),
    (parameter(2, 5, 93), "item 2", "latitude 93"),
    (parameter(2, 5, None), "item 2", "has latitude nothing"),
    (parameter(2, 5, float("nan")), "item 2", "has latitude nan"),
    (parameter(2, 5, 10**400), "item 2", "out of range"),
    (parameter(2, 6, float("inf")), "item 2", "has longitude inf"),
    (parameter(2, 6, -181), "item 2", "longitude -181"),
    (parameter(2, 7, None), "item 2", "has altitude nothing"),
    (parameter(2, 7, 1e30), "item 2", "1e+30 m above home"),
    (parameter(2, 7, 0), "item 2", "0 m above home"),
    (parameter(2, 7, float("nan")), "item 2", "has altitude nan"),
    (parameter(4, 7, 100), "item 4", "0 m above home"),  # at home's height above sea level
    (item(2, params=[0, 0, 0, None, 0, 0, 25]), "item 2", "has no place"),
    (parameter(1, 7, -1), "item 1", "-1 m above home"),
    (item(5, command=22), "item 5", "only the first thing"),
    (parameter(3, 1, None), "item 3", "speed type None"),
    (parameter(3, 2, -3), "item 3", "sets -3 m/s"),
    (parameter(3, 2, 1e9), "item 3", "sets 1e+09 m/s"),
    (parameter(3, 2, None), "item 3", "has speed nothing"),
    (parameter(3, 4, 1), "item 3", "parameter 4 1"),
    (item(3, command=20, params=[0] * 7), "item 4", "after the plan's return"),
    (parameter(6, 1, 1), "item 6", "parameter 1 1"),
    (item(6, command=21, params=[30, 0, 0, None, 0, 0, 0]), "item 6", "abort altitude 30"),
    (
        item(6, command=21, frame=3, params=[0, 0, 0, None, 39.3686, 22.9527, 9]),
        "item 6",
        "lands at an altitude",
    ),
    (mission(items=[]), "", "no waypoint"),
    (mission(items=[{}] * 10_001), "mission.items", "10001 items: at most 10000"),
    (mission(items=3), "", "`$.mission.items`"),
    (mission(plannedHomePosition=[91, 0, 0]), "plannedHomePosition", "latitude 91"),
    (mission(plannedHomePosition=[1, 2]), "", "`$.mission.plannedHomePosition`"),
    (mission(plannedHomePosition=[1, 2, float("inf")]), "plannedHomePosition", "altitude inf"),
    (mission(hoverSpeed=0), "hoverSpeed", "found 0"),
    (mission(hoverSpeed=float("nan")), "hoverSpeed", "found nan"),
    (mission(vehicleType=1), "mission.vehicleType", "1 is no multicopter"),
    (mission(version=1), "mission.version", "expected 2, found 1"),
    (fence(version=1), "geoFence.version", "expected 2, found 1"),
    (fence(breachReturn=[39.0, 22.0, 10]), "geoFence.breachReturn", "breach return"),
    (
        fence(polygons=[{"inclusion": True, "polygon": [[1, 2], [3, 4]], "version": 1}]),
        "inclusion polygon 1",
        "2",
    ),
    (
        fence(polygons=[{"inclusion": False, "polygon": [[1, 2], [3, 4], [95, 1]], "version": 1}]),
        "exclusion polygon 1",
        "latitude 95",
    ),
    (
        fence(polygons=[{"inclusion": True, "polygon": [[1, 2]] * 501, "version": 1}]),
        "geoFence",
        "500 corners",
    ),
    (fence(circles=circle(radius=0)), "inclusion circle 1", "radius 0 m"),
    (fence(circles=circle(radius=float("inf"))), "inclusion circle 1", "radius inf"),
    (fence(circles=circle(latitude_deg=float("nan"))), "inclusion circle 1", "latitude nan"),
    (fence(circles=circle(version=2)), "inclusion circle 1", "version 2"),
    (lambda document: document.update(fileType="Kml"), "fileType", 'found "Kml"'),
    (lambda document: document.update(version=2), "version", "expected 1, found 2"),
    (
        lambda document: document.update(rallyPoints={"points": [[39.0, 22.0, 20]], "version": 2}),
        "rallyPoints",
        "instead of home",
    ),
    (lambda document: document.pop("mission"), "", "`mission`"),
]


@pytest.mark.parametrize(("change", "where", "named"), REFUSED_PLANS)
def test_a_plan_that_is_not_understood_is_refused(
    tmp_path: Path, change: Any, where: str, named: str
) -> None:
    document = json.loads(PLAN)
    change(document)
    refused = refusal(tmp_path, json.dumps(document))
    assert (refused.key, named in refused.problem) == (where, True), refused.problem


REFUSED_LISTS = [
    ("QGC WPL 110", "QGC WPL 120", "line 1", "QGC WPL 110"),
    ("2\t0\t3\t16", "2\t0\t10\t16", "item 2", "frame 10"),
    ("2\t0\t3\t16", "2\t1\t3\t16", "item 2", "marked as current"),
    ("2\t0\t3\t16", "7\t0\t3\t16", "line 4", "expected item 2, found item 7"),
    ("2\t0\t3\t16", "2\t0\t-3\t16", "line 4", "whole number"),
    ("2\t0\t3\t16", "2\t0\t3\t16.5", "line 4", "whole number"),
    ("39.3676", "nan", "item 2", "has latitude nan"),
    ("39.3676", "-1e999", "line 4", 'found "-1e999"'),
    ("39.3676", "north", "line 4", 'found "north"'),
    ("39.3676\t", "", "line 4", "expected 12 numbers, found 11"),
    ("25\t1\n", "25\t0\n", "item 2", "autoContinue"),
    ("25\t1\n", "25\t2\n", "item 2", "found 2"),
    ("0\t1\t0\t16", "0\t1\t3\t16", "item 0", "which is home"),
    ("0\t1\t0\t16", "0\t1\t0\t22", "item 0", "which is home"),
    ("39.3666\t22.9507\t100", "nan\t0\t0", "item 0", "has latitude nan"),
]


@pytest.mark.parametrize(("old", "new", "where", "named"), REFUSED_LISTS)
def test_a_list_that_is_not_understood_is_refused(
    tmp_path: Path, old: str, new: str, where: str, named: str
) -> None:
    assert old in LIST
    refused = refusal(tmp_path, LIST.replace(old, new, 1))
    assert (refused.key, named in refused.problem) == (where, True), refused.problem


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("", "no plan"),
        ("<kml/>", "no plan"),
        ("QGC WPL 110\n", "no item"),
        ("QGC WPL 110\n" + LIST.splitlines()[1], "no waypoint"),
        ("{", "not valid JSON"),
        ("{}", "`mission`"),
        ('{"a": ' * 100_000, "not valid JSON"),
        ('{"a": ' + "9" * 5000 + "}", "not valid JSON"),
        (b"\xff\xfe{", "not UTF-8 text (byte 0)"),
        (b"{" + b" " * 10_000_000, "larger than 10 MB"),
        ("QGC WPL 110\n" + "\n".join(["0"] * 10_002), "at most 10000"),
    ],
)
def test_what_is_no_plan_at_all_is_refused(tmp_path: Path, content: str | bytes, named: str) -> None:
    assert named in refusal(tmp_path, content).problem


@pytest.mark.parametrize("name", ["missing.plan", ".", "\0", "x" * 5000, "/dev/zero"])
def test_what_is_no_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"no such file|cannot be read"):
        read_plan(tmp_path / name)


# --- whatever happens to a file -----------------------------------------------------------------------------


@settings(max_examples=400, deadline=None)
@given(data=st.data(), name=st.sampled_from(["field.plan", "field.waypoints", "survey.plan"]))
def test_a_mutilated_file_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, name: str
) -> None:
    content = bytearray((FOLDER / name).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        end = data.draw(st.integers(start, min(start + 12, len(content))))
        content[start:end] = data.draw(
            st.binary(max_size=4)
            | st.sampled_from([b"NaN", b"null", b"-1", b"1e999", b"0", b"[]", b"{}", b"true", b'"', b"\t"])
        )
    assert_read_or_refused(tmp_path_factory.getbasetemp() / "mutilated.plan", bytes(content))


values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=4,
)


def ways(value: object, way: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The ways to everything in a document."""
    match value:
        case dict():
            inner = [place for name, each in value.items() for place in ways(each, (*way, name))]
        case list():
            inner = [place for index, each in enumerate(value) for place in ways(each, (*way, index))]
        case _:
            inner = []
    return [way, *inner] if way else inner


@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_a_plan_with_any_other_value_in_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(["field.plan", "survey.plan"]))
    document = json.loads((FOLDER / name).read_text())
    for _ in range(data.draw(st.integers(1, 2))):
        *way, last = data.draw(st.sampled_from(ways(document)))
        parent = document
        for step in way:
            parent = parent[step]
        parent[last] = data.draw(values)
    assert_read_or_refused(
        tmp_path_factory.getbasetemp() / "changed.plan", json.dumps(document).encode("utf-8", "replace")
    )


def assert_read_or_refused(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    try:
        plan = read_plan(file)
    except ConfigError as refused:
        assert refused.problem
        return
    assert plan.waypoints
    for waypoint in plan.waypoints:
        assert abs(waypoint.place.latitude_deg) <= 90 and abs(waypoint.place.longitude_deg) <= 180
        assert 0 < waypoint.place.altitude_m <= 10_000
        assert waypoint.ground_speed_m_s is None or 0 < waypoint.ground_speed_m_s <= 100
        assert 0 <= waypoint.hold_s <= 3600 * 10_000
    assert len(plan.waypoints) <= 10_001
    assert all(str(notice) for notice in plan.notices)
