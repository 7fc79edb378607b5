"""A field with a bad corner: what one flight learns of it is worth something to the next."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import upwash
from upwash.config.world import EventAreaConfig, EventConfig
from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.preflight.acts import told_acts

SCENARIO = Path(__file__).parents[2] / "scenarios" / "thesis.toml"
MOVING = SCENARIO.with_name("on-the-move.toml")
CORNER = {"east_m": 160.0, "north_m": 160.0, "radius_m": 60.0, "probability": 0.8}


def field(tmp_path: Path, **policy: str) -> dict[str, Any]:
    return {
        "policy.stay_or_go": "learn",
        "event": {"probability": 0.03, "areas": [CORNER]},
        "mission.action_s": 5.0,
        "server.s1.remote_call_s": 4.0,
        "server.s2.remote_call_s": 4.0,
    } | {f"policy.{key}": value for key, value in policy.items()}


def goes(flown: upwash.Simulation) -> set[int | None]:
    return {event.waypoint for event in flown.events if isinstance(event, schema.StayOrGo) and event.goes}


def test_the_second_flight_stays_where_the_first_had_demands(tmp_path: Path) -> None:
    file = tmp_path / "demands.json"
    overrides = field(tmp_path, demand_map=str(file))
    plain = upwash.simulate(SCENARIO, overrides=field(tmp_path), seed=2)
    first = upwash.simulate(SCENARIO, overrides=overrides, seed=1, keep_demands=True)
    second = upwash.simulate(SCENARIO, overrides=overrides, seed=2)
    assert second.mission_time_s < 0.97 * plain.mission_time_s
    assert second.totals.turns_back < plain.totals.turns_back
    assert first.completed
    gone, corner = goes(second), EventAreaConfig(**CORNER).circle
    inside = {waypoint for waypoint in range(121) if corner.contains(Position(*_place(waypoint)))}
    assert len(inside - gone) > 0.8 * len(inside)
    assert len(gone - inside) > 0.8 * (121 - len(inside))


def _place(waypoint: int) -> tuple[float, float]:
    row, column = divmod(waypoint, 11)
    return 20.0 * (column if row % 2 == 0 else 10 - column), 20.0 * (10 - row)


def test_only_a_simulation_with_that_option_writes_the_map(tmp_path: Path) -> None:
    overrides = field(tmp_path, demand_map=str(tmp_path / "demands.json"))
    upwash.simulate(SCENARIO, overrides=overrides)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(
        upwash.UsageError, match=r"names no file for its map of demands: give policy\.demand_map"
    ):
        upwash.simulate(SCENARIO, overrides=field(tmp_path), keep_demands=True)


def test_the_first_area_around_a_waypoint_counts() -> None:
    inner = EventAreaConfig(east_m=0.0, north_m=0.0, radius_m=5.0, probability=0.0)
    outer = EventAreaConfig(east_m=0.0, north_m=0.0, radius_m=50.0, probability=0.5)
    event = EventConfig(probability=0.1, areas=(inner, outer))
    places = (Position(0.0, 5.0), Position(0.0, 6.0), Position(0.0, 51.0))
    assert [event.chance(place) for place in places] == [0.0, 0.5, 0.1]


def test_a_check_counts_the_areas_in_its_share_of_demands(tmp_path: Path) -> None:
    from upwash.lab.scenario import read_scenario

    inside = sum(
        EventAreaConfig(**CORNER).circle.contains(Position(*_place(waypoint))) for waypoint in range(121)
    )
    share = (0.8 * inside + 0.03 * (121 - inside)) / 121
    assert f"{100 * share:.3g} % of the answers" in told_acts(
        read_scenario(SCENARIO, overrides=field(tmp_path))
    )


def test_areas_need_a_probability_outside_them(tmp_path: Path) -> None:
    with pytest.raises(upwash.ConfigError, match="areas go with a probability outside them"):
        upwash.simulate(SCENARIO, overrides={"event": {"every": 10, "areas": [CORNER]}})


def test_on_rows_it_rests_where_demands_are_known_to_be_frequent(tmp_path: Path) -> None:
    event = {"probability": 0.0, "areas": [{**CORNER, "probability": 1.0}]}
    overrides = {"policy.stay_or_go": "learn", "event": event}
    mapped = {**overrides, "policy.demand_map": str(tmp_path / "demands.json")}
    upwash.simulate(MOVING, overrides=mapped, seed=1, keep_demands=True)
    plain = upwash.simulate(MOVING, overrides=overrides, seed=2)
    second = upwash.simulate(MOVING, overrides=mapped, seed=2)
    assert second.mission_time_s < 0.9 * plain.mission_time_s
    assert second.totals.turns_back < 0.5 * plain.totals.turns_back
    assert len(second.calls) == 121 and second.completed
