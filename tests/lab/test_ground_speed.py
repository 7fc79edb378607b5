"""The ground speed that `mission.speed = "auto"` chooses, against missions that are simulated at other speeds."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from tests.programs import ROOT
from tests.surveys import item, transects, written

from upwash.cli.main import main
from upwash.errors import ConfigError
from upwash.eventlog import schema
from upwash.lab.simulation import Simulation, simulate

SCENARIO = tomllib.loads((ROOT / "scenarios" / "on-the-move.toml").read_text())
SPEEDS_M_S = (2.0, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0)


def rows(count: int, length_m: float, *, every_m: float, **photos: Any) -> dict[str, Any]:
    ends = [[0.0, length_m] if number % 2 == 0 else [length_m, 0.0] for number in range(count)]
    places = [[east_m, 25.0 * number] for number, row in enumerate(ends) for east_m in row]
    return {"waypoints_m": places, "photos": {"every_m": every_m, **photos}}


def world(mission: Mapping[str, Any], **tables: Any) -> dict[str, Any]:
    document = copy.deepcopy(SCENARIO)
    del document["event"], document["mission"]["grid"], document["mission"]["ground_speed_m_s"]
    document["mission"] |= mission
    return document | {"camera": {"photo_s": 0.4}} | tables


SERVER = SCENARIO["server"][0] | {
    "east_m": 80.0,
    "north_m": 0.0,
    "range_m": 75.0,
    "remote_call_s": {"light": 0.3, "heavy": 1.0},
}
WORLDS = {
    # Above 3.5 m/s the photos pile up, and the drone computes them out of the server's range.
    "mapped in part of a range": world(rows(4, 160.0, every_m=5.0), server=[SERVER]),
    "alone, with stops": world(
        rows(6, 100.0, every_m=10.0, at_most=8),
        policy={"name": "local-only"},
        service=[{"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}],
    ),
    "a demand at each fourth photo": world(
        rows(6, 160.0, every_m=20.0), event={"every": 4, "offset": 1}, policy={"act_within_s": 0.0}
    ),
}


def at(speed_m_s: float | None, document: Mapping[str, Any]) -> Simulation:
    speed: dict[str, Any] = {"ground_speed_m_s": speed_m_s} if speed_m_s else {"speed": "auto"}
    return simulate({**document, "mission": document["mission"] | speed})


@pytest.mark.parametrize("document", WORLDS.values(), ids=WORLDS)
def test_the_chosen_speed_is_as_quick_as_the_best_of_all_simulated(document: Mapping[str, Any]) -> None:
    best_s = min(at(speed_m_s, document).mission_time_s for speed_m_s in SPEEDS_M_S)
    assert at(None, document).mission_time_s <= 1.03 * best_s


def test_a_flight_logs_the_speed_that_it_chose_and_explain_tells_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = WORLDS["alone, with stops"]
    run = at(None, document)
    (chosen,) = [event for event in run.events if isinstance(event, schema.SpeedChosen)]
    assert chosen.why.startswith(f"{chosen.ground_speed_m_s:g} m/s, ")
    assert at(chosen.ground_speed_m_s, document).mission_time_s == run.mission_time_s
    assert run.bound is not None
    assert (
        run.bound.free_s == pytest.approx(run.mission_time_s, rel=0.5)
        and run.bound.free_s < run.mission_time_s
    )

    scenario, log = tmp_path / "scenario.toml", tmp_path / "events.jsonl"
    text = (ROOT / "scenarios" / "on-the-move.toml").read_text()
    scenario.write_text(text.replace("ground_speed_m_s = 4.0", 'speed = "auto"'))
    assert main(["simulate", str(scenario), "--json", "--log", str(log)]) == 0
    logged = [json.loads(line) for line in log.read_text().splitlines()]
    (why,) = [event["why"] for event in logged if event["event"] == "speed_chosen"]
    assert " by forecast: the camera allows 20, mission.ground_speed_m_s 10" in why
    capsys.readouterr()
    assert main(["explain", str(log), "--waypoint", "0"]) == 0
    assert f"the ground speed was chosen: {why}" in capsys.readouterr().out.splitlines()


def test_the_highest_speed_blur_and_the_camera_limit_the_choice() -> None:
    quick = world(rows(1, 400.0, every_m=10.0), policy={"name": "local-only"})
    quick["service"] = [{"name": "detector", "local_call_s": {"light": 0.1, "heavy": 0.1}}]
    lens = {"photo_s": 2.0, "focal_px": 1000.0}  # 20 m high: a pixel is 2 cm
    chosen = {}
    for name, camera, most in (
        ("the file", {"photo_s": 0.0}, {"ground_speed_m_s": 6.0}),
        ("the camera", lens, {}),  # 10 m / 2 s
        ("blur", lens | {"exposure_s": 0.0025}, {}),  # half of 2 cm in 2.5 ms
    ):
        run = simulate(quick | {"camera": camera, "mission": quick["mission"] | {"speed": "auto"} | most})
        chosen[name] = next(e.ground_speed_m_s for e in run.events if isinstance(e, schema.SpeedChosen))
    assert chosen == {"the file": 6.0, "the camera": 5.0, "blur": 4.0}


def test_demands_of_earlier_flights_slow_the_choice(tmp_path: Path) -> None:
    document = WORLDS["a demand at each fourth photo"]
    policy = {**document["policy"], "demand_map": str(tmp_path / "demands.json")}
    for _ in range(4):
        simulate(
            document | {"policy": policy, "mission": document["mission"] | {"ground_speed_m_s": 4.0}},
            keep_demands=True,
        )
    without = {key: table for key, table in document.items() if key != "event"}
    told, untold = (
        next(e.ground_speed_m_s for e in at(None, world).events if isinstance(e, schema.SpeedChosen))
        for world in (without | {"policy": policy}, without)
    )
    assert told < untold


def test_a_survey_is_flown_at_the_chosen_speed_unless_its_items_set_one(tmp_path: Path) -> None:
    def flown(speed: str, *, turn_m: float = 0.0, more: tuple[Any, ...] = ()) -> Simulation:
        plan = written(tmp_path, [*more, *transects(turn_m)], mission=f"photos = {{}}\n{speed}", heavy_s=10.0)
        return simulate(plan)

    run = flown('speed = "auto"')
    (chosen,) = [event for event in run.events if isinstance(event, schema.SpeedChosen)]
    best_s = min(flown(f"ground_speed_m_s = {speed_m_s}").mission_time_s for speed_m_s in SPEEDS_M_S)
    assert run.mission_time_s <= 1.03 * best_s
    assert run.mission_time_s == flown(f"ground_speed_m_s = {chosen.ground_speed_m_s}").mission_time_s
    with pytest.raises(ConfigError, match=r"item 3 sets a speed"):
        flown('speed = "auto"', more=(item(178, 1, 5, -1, 0, 0, 0, 0),))
