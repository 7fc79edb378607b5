"""`upwash simulate`: its contract with those who call it, and that chance comes from the seed alone."""

from __future__ import annotations

import json
import math
import os
import pickle
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import upwash
from upwash.cli.main import main
from upwash.drone.mission import mission_failed
from upwash.eventlog.schema import Simulated
from upwash.lab.scenario import read_scenario

THESIS = Path(__file__).parents[2] / "scenarios" / "thesis.toml"
PATROL = THESIS.parents[1] / "examples" / "patrol.toml"
NOISE = "\n[noise]\ncall = 0.05\nleg = 0.05\n"


def simulate(capsys: pytest.CaptureFixture[str], scenario: Path, *options: str) -> dict[str, Any]:
    assert main(["simulate", str(scenario), "--json", *options]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def noisy(tmp_path: Path) -> Path:
    scenario = tmp_path / "noisy.toml"
    scenario.write_text(THESIS.read_text() + NOISE)
    return scenario


def test_json_is_one_object_with_the_fields_of_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    result = simulate(capsys, THESIS)
    assert list(result) == [
        "scenario", "policy", "seed", "mission_time_s", "completed", "calls", "totals", "bound",
        "upwash", "configuration",
    ]  # fmt: skip
    assert (result["scenario"], result["policy"], result["seed"]) == ("thesis", "location-aware", 1)
    assert result["completed"] is True
    assert list(result["calls"][0]) == [
        "waypoint", "operation", "place", "decision", "delay_s", "waited_s", "at_s", "asked",
    ]  # fmt: skip
    assert list(result["totals"]) == [
        "calls", "local", "remote", "waits", "waits_failed", "switches", "fallbacks", "service_delay_s", "lighter",
    ]  # fmt: skip


def test_the_totals_are_those_of_the_calls(capsys: pytest.CaptureFixture[str]) -> None:
    result = simulate(capsys, THESIS)
    calls, totals = result["calls"], result["totals"]
    assert [call["waypoint"] for call in calls] == list(range(121))
    assert totals["calls"] == totals["local"] + sum(totals["remote"].values()) == len(calls)
    assert totals["service_delay_s"] == pytest.approx(sum(call["delay_s"] for call in calls))
    assert totals["waits"] == sum(call["waited_s"] > 0 for call in calls) > 0


def test_policy_and_seed_can_be_given_instead_of_the_scenarios(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = noisy(tmp_path)
    seven = simulate(capsys, scenario, "--policy", "local-only", "--seed", "7")
    assert (seven["policy"], seven["seed"], seven["totals"]["remote"]) == ("local-only", 7, {})
    eight = simulate(capsys, scenario, "--policy", "local-only", "--seed", "8")
    assert seven["mission_time_s"] != eight["mission_time_s"]


@pytest.mark.parametrize(
    ("scenario", "options", "rows"), [(THESIS, [], 0), (THESIS, ["--calls"], 121), (PATROL, [], 5)]
)
def test_a_person_gets_the_result_before_the_rows_of_few_or_wanted_calls(
    scenario: Path, options: list[str], rows: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(scenario), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    starts = ["mission time ", "theoretical minimum ", r"\d+ of \d+ waypoints reached", r"\d+ calls: "]
    for line, start in zip(lines, starts, strict=False):
        assert re.match(start, line)
    shown = [line for line in lines if re.match(r" +\d+ +(drone|s\d) ", line)]
    assert len(shown) == rows and lines[len(lines) - rows :] == shown
    assert any("--calls" in line for line in lines) == (rows == 0)


def test_rows_of_calls_are_those_of_one_drone() -> None:
    assert main(["simulate", str(THESIS.with_name("fleet-vanishing.toml")), "--calls"]) == 2


def test_what_there_is_one_of_is_told_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(PATROL)]) == 0
    assert (
        "5 calls: 1 on the drone, 4 on s1; 1 selection of a server; no waits; none fell back"
        in capsys.readouterr().out
    )


def test_the_same_scenario_and_seed_leave_the_same_log_in_any_process(tmp_path: Path) -> None:
    scenario = noisy(tmp_path)
    logs = [tmp_path / f"{name}.jsonl" for name in ("first", "second", "hash_0", "hash_4711")]
    for log in logs[:2]:
        assert main(["simulate", str(scenario), "--json", "--log", str(log)]) == 0
    for log, seed in zip(logs[2:], ("0", "4711"), strict=True):
        subprocess.run(
            [sys.executable, "-m", "upwash", "simulate", str(scenario), "--json", "--log", str(log)],
            env={**os.environ, "PYTHONHASHSEED": seed},
            stdout=subprocess.DEVNULL,
            check=True,
        )
    first = logs[0].read_bytes()
    assert first.count(b"\n") > 121
    assert all(log.read_bytes() == first for log in logs[1:])


@pytest.mark.parametrize(
    ("good", "bad", "key"),
    [
        ("range_m = 100.0", "range_m = -100.0", "server[0].range_m"),
        ('mode = "heavy"', 'mode = "heavier"', "mission.mode"),
        ("load_w = 4.0", "load_watts = 4.0", "heat"),
    ],
)
def test_a_bad_scenario_is_refused_by_its_key(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, good: str, bad: str, key: str
) -> None:
    scenario, log = tmp_path / "bad.toml", tmp_path / "log.jsonl"
    scenario.write_text(THESIS.read_text().replace(good, bad))
    assert main(["simulate", str(scenario), "--json", "--log", str(log)]) == 2
    captured = capsys.readouterr()
    assert f"{scenario}: {key}" in captured.err
    assert captured.out == ""
    assert not log.exists()


def test_a_mission_that_fails_still_shows_its_result(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "hasty.py").write_text(
        "def fly(drone):\n    drone.autopilot.arm()\n    drone.autopilot.goto(drone.plan[0])\n"
    )
    scenario = tmp_path / "hasty.toml"
    scenario.write_text(THESIS.read_text().replace('program = "survey"', 'program = "hasty.py:fly"'))
    assert main(["simulate", str(scenario), "--json"]) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out)["completed"] is False
    assert "not completed: goto: the vehicle is on the ground" in captured.err


BUGGY = """
def fly(drone):
    drone.autopilot.arm()
    look(None)

def look(photo):
    return photo.size
"""


def test_a_mission_with_a_bug_is_one_message_and_its_own_trace(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "buggy.py").write_text(BUGGY)
    scenario = tmp_path / "buggy.toml"
    scenario.write_text(THESIS.read_text().replace('program = "survey"', 'program = "buggy.py:fly"'))
    assert main(["simulate", str(scenario)]) == 1
    said = capsys.readouterr().err.splitlines()
    assert said[-1] == (
        "upwash: the mission program raised AttributeError: 'NoneType' object has no attribute 'size'"
    )
    assert [line.split('"')[1] for line in said if line.startswith("  File ")] == [
        str(tmp_path / "buggy.py")
    ] * 2


def test_a_mission_with_a_bug_is_told_from_another_process_too() -> None:
    try:
        raise ValueError("no idea")
    except ValueError as error:
        failed = mission_failed(error)
    again = pickle.loads(pickle.dumps(failed))
    assert (str(again), again.trace) == ("the mission program raised ValueError: no idea", failed.trace)
    assert "test_simulate.py" in failed.trace


def test_figures_are_drawn_on_request(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    simulate(capsys, THESIS, "--figures", str(tmp_path / "figures"))
    assert sorted(file.name for file in (tmp_path / "figures").iterdir()) == ["call_delay.png", "map.png"]


def test_a_camera_over_a_park_shows_a_mission_real_photos_and_the_log_their_truth(tmp_path: Path) -> None:
    mission = tmp_path / "looking.py"
    mission.write_text(
        "def look(drone):\n    drone.autopilot.arm()\n    drone.autopilot.takeoff(15.0)\n"
        "    for waypoint in drone.plan:\n        drone.autopilot.goto(waypoint)\n"
        "        drone.user.notify(len(drone.camera.take_photo()), at=waypoint)\n    drone.end_flight()\n"
    )
    scenario = tmp_path / "park.toml"
    scenario.write_text(
        f'[mission]\nprogram = "{mission}:look"\nwaypoints_m = [[0, 0], [40, 0], [0, 0]]\naltitude_m = 15.0\n'
        "[camera]\npark_seed = 3\n"
    )
    log = tmp_path / "events.jsonl"
    assert main(["simulate", str(scenario), "--json", "--log", str(log)]) == 0
    events = [json.loads(line) for line in log.read_text().splitlines()]
    photos = [event for event in events if event["event"] == "photo"]
    sizes = [event["message"] for event in events if event["event"] == "notified"]
    assert [photo["bytes"] for photo in photos] == sizes
    assert all(400_000 <= size <= 450_000 for size in sizes)
    assert [photo["position"]["east_m"] for photo in photos] == pytest.approx([0, 40, 0], abs=1)
    first, other, again = ([fault["label"] for fault in photo["truth"]] for photo in photos)
    assert first == again != other


def test_a_scenario_of_a_program_may_have_tuples_and_turns_without_end() -> None:
    document = tomllib.loads(PATROL.read_text())
    document["mission"] |= {"program": f"{PATROL.parent}/patrol.py:patrol", "waypoints_m": ((0, 0), (20, 0))}
    overrides = {"server.s1.truth": {"slots": 1, "turn_s": math.inf}}
    config = read_scenario(document, overrides=overrides)
    assert config.servers[0].truth.turn_s == math.inf
    assert config.mission.waypoints_m == ((0, 0), (20, 0))


def test_a_call_takes_its_processing_and_the_transfer_at_the_bandwidth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    patrol = Path(__file__).parents[2] / "examples" / "patrol.toml"
    scenario = tmp_path / "patrol.toml"
    text = patrol.read_text().replace("remote_call_s = 0.5", "processing_s = 0.5\nbandwidth_bit_s = 1e6")
    text = text.replace('"patrol.py:', f'"{patrol.parent}/patrol.py:')
    scenario.write_text(text.replace("local_call_s = 6.0", "local_call_s = 6.0\nrequest_bytes = 250_000"))
    remote = [call for call in simulate(capsys, scenario)["calls"] if call["place"] == "s1"]
    assert [call["delay_s"] - call["waited_s"] for call in remote] == [pytest.approx(2.504)] * len(remote)
    assert remote


def test_a_result_says_what_it_was_made_of_and_by_what(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = tmp_path / "secret.toml"
    scenario.write_text(THESIS.read_text() + '\n[user]\nwebhook = "https://example.org/hook?token=hidden"\n')
    log = tmp_path / "log.jsonl"
    result = simulate(capsys, scenario, "--policy", "opportunistic", "--seed", "3", "--log", str(log))
    written = result["configuration"]
    assert (written["policy"]["name"], written["seed"], written["server"][0]["name"]) == (
        "opportunistic",
        3,
        "s1",
    )
    again = upwash.simulate(written)
    assert again.mission_time_s == result["mission_time_s"]
    opening = upwash.read_log(log)[0]
    assert isinstance(opening, Simulated)
    assert json.loads(opening.configuration) == written
    assert {"version": opening.upwash, "commit": opening.commit} == result["upwash"]
    assert "hidden" not in log.read_text()
    if (THESIS.parents[1] / ".git").exists():
        head = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=THESIS.parents[1], capture_output=True, text=True, check=True
        ).stdout.strip()
        assert opening.commit == head
