"""Which waypoints a flight that was broken off has behind it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.events import event as made

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.drone.resumption import order_begun, ordered_down, waypoints_done
from upwash.errors import UsageError
from upwash.eventlog.schema import Event
from upwash.real.host.journal import read_events

PLACES = [[0.0, 0.0], [20.0, 0.0], [40.0, 30.0]]


def config(services: int = 1, **mission: Any) -> DroneConfig:
    names = ["detector", "counter"][:services]
    document = {
        "mission": {"mode": "heavy", "waypoints_m": PLACES, **mission},
        "service": [
            {"name": name, "program": "a:B", "local_call_s": {"light": 3.0, "heavy": 10.0}} for name in names
        ],
    }
    return drone_config(document, Path("drone.toml"))


def event(name: str, **facts: Any) -> Event:
    return made(name, 0.0, **facts)


def at(index: int, *results: str) -> list[Event]:
    east_m, north_m = PLACES[index]
    place = {"waypoint": index, "east_m": east_m, "north_m": north_m}
    return [
        event("leg", **place),
        event("arrived", **place),
        *(event("call", operation=result) for result in results),
    ]


OPENED = event("log_opened", time="2026-01-01T00:00:00+00:00")
STARTED = event("mission_started", drone="drone", policy="location-aware", waypoints=3)
BEGUN = [OPENED, STARTED]


def done(*events: Event, services: int = 1) -> list[int]:
    return sorted(waypoints_done(events, config(services)))


def test_nothing_is_done_before_the_first_result() -> None:
    assert done(*BEGUN) == done(*BEGUN, *at(0)) == []


def test_a_log_that_has_lost_its_first_line_counts_all_the_same() -> None:
    assert done(STARTED, *at(0, "look")) == [0]


def test_a_call_of_a_waypoint_that_the_drone_has_not_reached_does_not_count() -> None:
    assert done(*BEGUN, event("call_started", waypoint=1), event("call")) == []


def test_a_hundredth_of_a_metre_is_the_same_place() -> None:
    assert done(*BEGUN, event("arrived", waypoint=0, east_m=0.01, north_m=0.0), event("call")) == [0]


def begun(*events: Event) -> tuple[list[int], str] | None:
    order = order_begun(events, config())
    return None if order is None else ([waypoint.index for waypoint in order.waypoints], order.why)


def test_the_order_begun_is_that_of_the_last_flight_in_the_log() -> None:
    planned = event("planned", order=[2, 0, 1], order_why="shorter")
    assert begun(OPENED) == begun(OPENED, planned, OPENED, STARTED) is None
    assert (
        begun(OPENED, planned, STARTED) == begun(OPENED, event("planned"), planned) == ([2, 0, 1], "shorter")
    )
    assert begun(OPENED, event("planned", order=[])) == ([0, 1, 2], "")
    for order in ([0, 1], [0, 1, 2, 3], [0, 1, 3]):
        with pytest.raises(UsageError, match="its order is of other waypoints than there are now"):
            begun(OPENED, event("planned", order=order))


def test_a_waypoint_is_done_with_its_result_and_the_next_one_is_not() -> None:
    assert done(*BEGUN, *at(0, "look")) == [0]
    assert done(*BEGUN, *at(0, "look"), event("leg", waypoint=1)) == [0]
    assert done(*BEGUN, *at(0, "look"), *at(1)) == [0]
    assert done(*BEGUN, *at(0, "look"), *at(1, "look"), *at(2, "look")) == [0, 1, 2]


def test_a_waypoint_is_done_only_with_as_many_results_as_those_before() -> None:
    two = at(0, "look", "count")
    assert done(*BEGUN, *at(0, "look"), services=2) == []
    assert done(*BEGUN, *two, services=2) == [0]
    assert done(*BEGUN, *two, *at(1, "look"), services=2) == [0]
    assert done(*BEGUN, *two, *at(1, "look", "count"), services=2) == [0, 1]
    assert done(*BEGUN, *at(0, "look", "look"), *at(1, "look")) == [0], "one service, called twice"


def test_an_answer_that_comes_at_the_next_waypoint_does_not_make_that_one_done() -> None:
    asked = [*at(0), event("call_started", waypoint=0), *at(1), event("call", operation="look")]
    assert done(*BEGUN, *asked) == []
    assert done(*BEGUN, *asked, event("answer_taken", waypoint=0)) == [0]


def test_a_mission_that_calls_nothing_sees_its_last_waypoint_again() -> None:
    assert done(*BEGUN, *at(0), *at(1)) == [0]


def test_a_waypoint_that_the_vehicle_returned_from_without_a_result_is_not_done() -> None:
    assert done(*BEGUN, *at(0, "look"), *at(1), event("returning"), event("landed")) == [0]


def test_the_parts_of_a_flight_that_was_taken_up_count_together() -> None:
    again = [event("log_resumed"), STARTED]
    assert done(*BEGUN, *at(0, "look"), *at(1), *again, *at(1, "look")) == [0, 1]


def test_an_earlier_flight_in_the_same_file_does_not_count() -> None:
    earlier = [*BEGUN, *at(0, "look"), *at(1, "look"), event("mission_completed")]
    assert done(*earlier, *BEGUN, *at(0, "look")) == [0]


def test_a_waypoint_that_the_drone_only_circles_is_not_done() -> None:
    around = event("leg", waypoint=None, east_m=5.0, north_m=5.0)
    assert done(*BEGUN, *at(0), around) == []
    assert done(*BEGUN, *at(0), around, event("call")) == [0]


@pytest.mark.parametrize(
    ("events", "why"),
    [
        ([*BEGUN, event("mission_completed")], "was completed: there is nothing to take up"),
        ([OPENED, msgspec.structs.replace(STARTED, drone="heron")], "of the drone heron, not of drone"),
        ([OPENED, msgspec.structs.replace(STARTED, waypoints=4)], "it had 4 waypoints, and the plan has 3"),
        (
            [*BEGUN, event("arrived", waypoint=1, east_m=25.0, north_m=0.0)],
            "waypoint 1 was 5.00 m from where it is now",
        ),
        (
            [*BEGUN, event("arrived", waypoint=2, east_m=40.0, north_m=18.0)],
            "waypoint 2 was 12.00 m from where it is now",
        ),
        ([*BEGUN, event("arrived", waypoint=7, east_m=25.0, north_m=0.0)], "the plan has no waypoint 7"),
    ],
)
def test_a_log_of_something_else_is_refused(events: list[Event], why: str) -> None:
    with pytest.raises(UsageError, match=why):
        waypoints_done(events, config())


FACTS = st.fixed_dictionaries(
    {},
    optional={
        "t": st.floats(0, 1e6) | st.text(max_size=2),
        "event": st.sampled_from(["log_opened", "mission_started", "leg", "arrived", "call", "?"])
        | st.none(),
        "time": st.sampled_from(["2026-01-01T00:00:00+00:00", "2026-01-01T00:00:00", "today", 7]),
        "drone": st.sampled_from(["drone", "heron", None]),
        "waypoints": st.integers(-1, 4) | st.text(max_size=2),
        "waypoint": st.integers(-1, 4) | st.text(max_size=2),
        "east_m": st.sampled_from([0.0, 20.0, 1e300, "0"]),
        "north_m": st.sampled_from([0.0, 0, None]),
    },
)


@given(
    lines=st.lists(
        st.sampled_from([msgspec.json.encode(each) for each in (*BEGUN, *at(0, "look"), *at(1, "look"))])
        | FACTS.map(msgspec.json.encode)
        | st.binary(max_size=20),
        max_size=6,
    )
)
def test_any_file_is_a_log_to_take_up_or_a_usage_error(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes]
) -> None:
    log = tmp_path_factory.getbasetemp() / "any.jsonl"
    log.write_bytes(b"".join(line + b"\n" for line in (msgspec.json.encode(OPENED), *lines)))
    try:
        assert waypoints_done(read_events(log), config()) <= {0, 1, 2}
    except UsageError:
        return


def test_a_log_without_its_time_of_day_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    log.write_bytes(b'{"event":"log_opened","t":0.0}\n')
    with pytest.raises(UsageError, match="is not an event log"):
        read_events(log)


HERE = {"position": {"east_m": 0.0, "north_m": 0.0, "altitude_m": 9.0}}


@pytest.mark.parametrize(
    ("events", "ordered"),
    [
        ([], None),
        ([event("armed", **HERE)], None),
        ([event("returning", **HERE)], "return"),
        ([event("landing", **HERE)], "land"),
        ([event("safe_end", action="return", why="x")], "return"),
        ([event("safe_end", action="land", why="x")], "land"),
        ([event("returning", **HERE), event("safe_end", action="hold", why="x")], None),
        ([event("returning", **HERE), event("landed", **HERE)], None),
        ([event("returning", **HERE), event("control", owner="pilot", why="x")], None),
        ([event("returning", **HERE), event("control", owner="earlier run", why="x")], "return"),
        ([event("returning", **HERE), event("landed", **HERE), *at(0)], None),
    ],
)
def test_the_last_order_of_a_log_tells_how_the_vehicle_comes_down(
    events: list[Event], ordered: str | None
) -> None:
    assert ordered_down([*BEGUN, *events]) == ordered
