"""`upwash fly` with a plan above the sea, on a stand-in that stands 488 m above it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.events import read
from tests.programs import HOME, stand_in

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
PLACE = "{latitude_deg},{longitude_deg}".format(**HOME)


@pytest.fixture
def fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[float], int]]:
    """Flies a plan whose home has that altitude; returns the exit code."""
    monkeypatch.chdir(tmp_path)
    Path("patrol.py").write_text(MISSION)
    Path("drone.toml").write_text('[mission]\nprogram = "patrol.py:patrol"\nplan = "field.waypoints"\n')
    options = ("--home", PLACE, "--home-altitude", "488", "--acceleration", "50")
    with stand_in(tmp_path, *options, listen="tcp:127.0.0.1:0") as connection:

        def flown(home_m: float) -> int:
            Path("field.waypoints").write_text(
                f"QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t39.3666\t22.9507\t{home_m}\t1\n"
                "1\t0\t3\t22\t0\t0\t0\t0\t39.3666\t22.9507\t15\t1\n"
                "2\t0\t0\t16\t0\t0\t0\t0\t39.3667\t22.9507\t530\t1\n"
            )
            command = ["fly", "--config", "drone.toml", "--autopilot", connection]
            return main([*command, "--log", "events.jsonl"])

        yield flown


@pytest.mark.parametrize("home_m", [0, 480])
def test_it_is_flown_above_the_vehicles_home(fly: Callable[[float], int], home_m: float) -> None:
    assert fly(home_m) == 0
    (planned,) = read("events.jsonl", "planned")
    assert planned["altitudes_m"] == [42.0]
    (returning,) = read("events.jsonl", "returning")
    assert returning["position"]["altitude_m"] == pytest.approx(42.0, abs=1.0)


def test_it_is_refused_where_the_homes_do_not_agree(
    fly: Callable[[float], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert fly(100) == 1
    said = capsys.readouterr().err
    assert "the plan's home is 100 m above the sea, the vehicle's 488 m" in said
    assert said.count("\n") == 1
    assert not read("events.jsonl", "arming")
    assert read("events.jsonl")[-1]["event"] == "mission_ended"
