"""How a ground speed is searched for, and the world in which the missions for that are flown."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.lab.test_ground_speed import WORLDS, at

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.drone.speed import SpeedLimit
from upwash.errors import MissionFailed
from upwash.eventlog import schema
from upwash.lab.believed import believed_worlds, demand_chances
from upwash.lab.flown_rows import RowForecast
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.lab.speed import choose_speed, chosen_speed, forecast_speed, with_speed

ROWS_M = 1000.0


def config(world: str, **tables: Any) -> DroneConfig:
    document = WORLDS[world]
    mission = {**document["mission"], "speed": "auto", **tables.pop("mission", {})}
    return read_scenario({**document, **tables, "mission": mission})


def searched(
    time_s: Callable[[float], float], *limits_m_s: float, most: int = 12, rows_m: float = ROWS_M
) -> tuple[float, list[float]]:
    """The speed chosen where missions take these times, and all that were tried."""
    tried: list[float] = []

    def forecast(speed_m_s: float) -> RowForecast:
        tried.append(speed_m_s)
        return RowForecast(
            ground_speed_m_s=speed_m_s,
            mission_s=time_s(speed_m_s),
            rows=(),
            stops=0,
            waited_s=time_s(speed_m_s) - rows_m / speed_m_s,
            turns_back=0,
            keeps_up=True,
        )

    limits = [SpeedLimit("a rule", limit_m_s) for limit_m_s in limits_m_s]
    return choose_speed(limits, forecast, rows_m=rows_m, most=most).ground_speed_m_s, tried


@pytest.mark.parametrize("limits_m_s", [(8.34, 12.0), (12.0, 8.34), (0.0567,)])
def test_a_drone_that_waits_for_no_answer_flies_as_fast_as_is_allowed(limits_m_s: tuple[float, ...]) -> None:
    speed_m_s, tried = searched(lambda speed_m_s: ROWS_M / speed_m_s, *limits_m_s)
    assert tried == [speed_m_s]
    assert 0.98 * min(limits_m_s) < speed_m_s <= min(limits_m_s)


@pytest.mark.parametrize("most", [4, 6, 12])
@pytest.mark.parametrize("best_m_s", [0.7, 2.0, 5.5, 9.0])
def test_a_speed_between_is_found_with_few_missions(best_m_s: float, most: int) -> None:
    """Beyond the best speed each m/s costs as much as the rows at that speed save."""

    def time_s(speed_m_s: float) -> float:
        slow_s = ROWS_M / min(speed_m_s, best_m_s)
        return slow_s * (1 + max(0.0, speed_m_s - best_m_s) / 10.0)

    speed_m_s, tried = searched(time_s, 10.0, most=most)
    assert len(tried) <= most and max(tried) <= 10.0 and len(set(tried)) == len(tried)
    assert time_s(speed_m_s) <= {4: 1.35, 6: 1.2, 12: 1.05}[most] * time_s(best_m_s)


def test_of_speeds_as_quick_the_lowest_is_chosen() -> None:
    speed_m_s, tried = searched(lambda speed_m_s: max(400.0, ROWS_M / speed_m_s), 10.0)
    assert 2.5 <= speed_m_s <= 3.0
    assert min(tried) >= 0.9 * 2.5, "slower, the rows alone take longer"


@pytest.mark.parametrize("rows_m", [0.0, 1e-9])
def test_rows_without_length_have_a_speed(rows_m: float) -> None:
    speed_m_s, tried = searched(lambda speed_m_s: 100.0, 8.0, rows_m=rows_m)
    assert speed_m_s == min(tried) >= 0.1


def test_the_missions_are_flown_in_the_world_that_the_drone_believes_in() -> None:
    """Truths, faults, noise, heat and batteries change neither the choice nor the forecast."""
    plain = config("mapped in part of a range")
    server = plain.servers[0]
    true = config(
        "mapped in part of a range",
        server=[
            {
                **WORLDS["mapped in part of a range"]["server"][0],
                "truth": {"range_m": 10.0, "remote_call_s": 9.0, "join_s": 20.0},
            }
        ],
        fault=[{"target": server.name, "kind": "off"}],
        noise={"call": 0.3, "leg": 0.1},
        heat={"ambient_c": 60.0},
        energy={"battery_wh": 0.5},
        seed=7,
    )
    assert simulate(true).failure, "the battery does not last"
    assert believed_worlds(true) == believed_worlds(plain)
    assert chosen_speed(true, simulate) == chosen_speed(plain, simulate)
    given, why = with_speed(true, simulate)
    assert given.servers == true.servers and given.faults == true.faults, "its speed alone is another"
    assert given.mission.speed == "given" and why.startswith(f"{given.mission.ground_speed_m_s:g} m/s, ")


def test_the_forecast_is_what_is_flown_where_all_is_as_believed() -> None:
    for name in WORLDS:
        given = config(name, mission={"speed": "given", "ground_speed_m_s": 6.0})
        forecast, flown = forecast_speed(given, simulate), at(6.0, WORLDS[name])
        assert forecast.mission_s == flown.mission_time_s
        assert forecast.stops == sum(isinstance(event, schema.PhotosWait) for event in flown.events)
        assert sum(row.photos for row in forecast.rows) == flown.waypoints
        assert [row.row for row in forecast.rows] == list(range(len(forecast.rows)))


@pytest.mark.parametrize(
    "areas", [(), ({"east_m": 0.0, "north_m": 0.0, "radius_m": 60.0, "probability": 0.6},)]
)
def test_as_many_answers_demand_an_act_as_is_likely_evenly_spread(
    areas: tuple[dict[str, float], ...],
) -> None:
    world = config("a demand at each fourth photo", event={"probability": 0.2, "areas": list(areas)})
    likely = sum(demand_chances(world))
    worlds = believed_worlds(world)
    assert len(worlds) == 3
    for each in worlds:
        assert sum(demand_chances(each)) == pytest.approx(likely, abs=1.0)
        assert set(demand_chances(each)) == {0.0, 1.0}
    assert forecast_speed(world, simulate).worlds == 3
    assert len(believed_worlds(config("a demand at each fourth photo"))) == 1, "every fourth is no chance"


@pytest.mark.parametrize(
    "error", [MissionFailed("a bug"), ValueError("the photo is empty"), RecursionError()]
)
def test_where_no_mission_can_be_flown_the_highest_allowed_speed_is_taken(error: Exception) -> None:
    def fails(_: DroneConfig) -> Any:
        raise error

    world = config("alone, with stops", camera={"photo_s": 2.0})
    chosen = chosen_speed(world, fails)
    assert chosen.ground_speed_m_s == 5.0 and chosen.forecast is None
    reason = str(error) or "RecursionError"
    assert chosen.why.endswith(f"the camera allows 5, mission.ground_speed_m_s 10; no forecast, as {reason}")


def test_a_choice_writes_no_map_of_demands_or_coverage(tmp_path: Path) -> None:
    kept = tmp_path / "demands.json"
    chosen_speed(
        config("alone, with stops", policy={"name": "local-only", "demand_map": str(kept)}), simulate
    )
    assert list(tmp_path.iterdir()) == []


def test_earlier_flights_tell_where_answers_demand_acts(tmp_path: Path) -> None:
    kept = tmp_path / "demands.json"
    place = {"east_m": 80.0, "north_m": 25.0, "answers": 4.0, "demands": 4.0}
    kept.write_text(json.dumps({"upwash_demands": 1, "places": [place]}))
    world = config("a demand at each fourth photo", policy={"demand_map": str(kept)}, event=None)
    chances = demand_chances(world)
    nearest = min(
        waypoints(world.mission), key=lambda spot: ground_distance_m(spot.position, Position(80.0, 25.0))
    )
    assert max(chances) == chances[nearest.index] > 1.4 * min(chances)
    assert len(believed_worlds(world)) == 3
