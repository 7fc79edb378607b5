"""Where a resting drone waits for the answers to a line of photos, on virtual time."""

from __future__ import annotations

from typing import Any

import pytest
from tests.drone.test_pending import of
from tests.programs import ROOT
from tests.scenarios import scenario, server

import upwash
from upwash.config.drone import DroneConfig
from upwash.core.geo import Position, ground_distance_m
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate

# Eight rows of six photos from the north to the south: the last ones are out of the range.
GRID = {"columns": 6, "rows": 8, "spacing_m": 15.0, "start": "top-left"}
RANGE_M = 70.0
VEHICLE = {"acceleration_m_s2": 1.5, "takeoff_s": 10.0, "return_and_land_s": 16.0}


def field(
    *, at_m: tuple[float, float] = (37.5, 105.0), call_s: float = 0.7, photos: Any = None, **tables: Any
) -> DroneConfig:
    near = server("s1", *at_m, range_m=RANGE_M, check_s=11.5, check_running_s=3.5)
    near["remote_call_s"] = {"light": 0.3, "heavy": call_s}
    mission = {"grid": GRID, "photos": {"every_m": 15.0, **(photos or {})}, "ground_speed_m_s": 5.0}
    mission |= tables.pop("mission", {})
    service = {"name": "detector", "local_call_s": {"light": 5.0, "heavy": 10.0}}
    given = {"vehicle": VEHICLE, "camera": {"photo_s": 0.5}, "service": [service]} | tables
    return scenario(near, mission=mission, **given)


def flown(config: DroneConfig) -> tuple[Run, float]:
    run = simulate(config)
    assert run.failure == "" and run.result.completed
    assert run.result.mission_time_s is not None
    return run, run.result.mission_time_s


def test_a_backlog_at_the_end_of_the_way_is_answered_in_a_range_that_is_flown_to() -> None:
    run, took_s = flown(field())
    (sought,) = of(list(run.events), schema.SoughtAnswers)
    assert ground_distance_m(sought.position, Position(37.5, 105.0)) <= RANGE_M
    assert took_s == pytest.approx(238.0, rel=0.015), "by a model of its own"


@pytest.mark.parametrize(
    "tables",
    [
        {"policy": {"detour_s": 0.0}},
        {"policy": {"name": "local-only"}},
        {"call_s": 11.0},
        {"at_m": (37.5, 900.0)},
        {"mission": {"reserve_s": 20.0}, "vehicle": VEHICLE | {"endurance_s": 240.0}},
    ],
    ids=["no stop allowed", "no servers", "not faster", "too far", "the reserve"],
)
def test_a_drone_stays_where_a_flight_is_not_allowed_or_saves_nothing(tables: dict[str, Any]) -> None:
    run = simulate(field(**tables))
    assert of(list(run.events), schema.SoughtAnswers) == []


def test_a_drone_with_too_many_open_answers_waits_for_all_of_them_in_a_range() -> None:
    """The way from there on passes no range; it comes back to its row."""
    photos = {"at_most": 8}
    run, took_s = flown(field(photos=photos))
    sought = of(list(run.events), schema.SoughtAnswers)
    assert len(sought) >= 1
    _, stays_s = flown(field(photos=photos, policy={"detour_s": 0.0}))
    assert took_s < stays_s


def test_no_range_is_sought_once_all_answers_are_there() -> None:
    """The first flight to a range brings the last answer on the way, which a second flight would keep waiting."""
    events = list(upwash.simulate(ROOT / "scenarios" / "on-the-move.toml").events)
    sought = [number for number, event in enumerate(events) if isinstance(event, schema.SoughtAnswers)]
    assert sought
    for number in sought:
        before = events[:number]
        assert len(of(before, schema.Call)) < len(of(before, schema.PhotoTaken))


def test_a_server_is_joined_for_the_line_though_few_photos_come() -> None:
    """Only the last row is in its range: six photos there, and the line of all before."""
    last_row: dict[str, Any] = {"at_m": (37.5, -50.0), "policy": {"detour_s": 0.0}}
    run, took_s = flown(field(**last_row))
    alone_s = flown(field(**last_row | {"policy": {"name": "local-only"}}))[1]
    selected = [event for event in run.events if isinstance(event, schema.Selected)]
    last_s = [event.t for event in of(list(run.events), schema.Arrived)][-6]
    assert selected[0].t < last_s + 5.0
    assert sum(call.server == "s1" for call in run.result.calls) > 20
    assert took_s < 0.75 * alone_s
