"""`upwash fly` with a plan above the sea, on a stand-in that stands 488 m above it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from upwash.cli.main import main

pytestmark = pytest.mark.system

MISSION = """
def patrol(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
    drone.end_flight()
"""


@pytest.fixture
def connection() -> Iterator[str]:
    options = [
        "--home=39.3666,22.9507",
        "--home-altitude",
        "488",
        "--armable-after",
        "2",
        "--acceleration",
        "50",
    ]
    command = [
        sys.executable,
        "-m",
        "upwash",
        "vehicle",
        "--listen",
        "tcp:127.0.0.1:0",
        *options,
        "--speedup",
        "5",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip().partition(" ready at ")[2]
        finally:
            process.terminate()


def written(folder: Path, *, home_m: float) -> None:
    (folder / "patrol.py").write_text(MISSION)
    (folder / "photos").mkdir()
    (folder / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    (folder / "field.waypoints").write_text(
        f"QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t39.3666\t22.9507\t{home_m}\t1\n"
        "1\t0\t3\t22\t0\t0\t0\t0\t39.3666\t22.9507\t15\t1\n"
        "2\t0\t0\t16\t0\t0\t0\t0\t39.3667\t22.9507\t530\t1\n"
    )
    (folder / "drone.toml").write_text(
        '[mission]\nprogram = "patrol.py:patrol"\nplan = "field.waypoints"\n[camera]\nfolder = "photos"\n'
    )


@pytest.mark.parametrize("home_m", [0, 480])
def test_it_is_flown_above_the_vehicles_home(
    connection: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home_m: float
) -> None:
    written(tmp_path, home_m=home_m)
    monkeypatch.chdir(tmp_path)
    assert main(["fly", "--config", "drone.toml", "--autopilot", connection, "--log", "events.jsonl"]) == 0
    events = [json.loads(line) for line in Path("events.jsonl").read_text().splitlines()]
    (planned,) = (event for event in events if event["event"] == "planned")
    assert planned["altitudes_m"] == [42.0]
    (returning,) = (event for event in events if event["event"] == "returning")
    assert returning["position"]["altitude_m"] == pytest.approx(42.0, abs=1.0)


def test_it_is_refused_where_the_homes_do_not_agree(
    connection: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path, home_m=100)
    monkeypatch.chdir(tmp_path)
    assert main(["fly", "--config", "drone.toml", "--autopilot", connection, "--log", "events.jsonl"]) == 1
    said = capsys.readouterr().err
    assert "the plan's home is 100 m above the sea, the vehicle's 488 m" in said
    assert said.count("\n") == 1
    events = [json.loads(line)["event"] for line in Path("events.jsonl").read_text().splitlines()]
    assert "arming" not in events
    assert events[-1] == "mission_ended"
