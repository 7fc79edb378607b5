"""`upwash check` with several drones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import upwash
from upwash.cli.main import main

FLEET = """
[mission]
grid = { columns = 4, rows = 3, spacing_m = 20.0 }

[vehicle]
endurance_s = 175.0

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 20.0
north_m = 20.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[[server]]
name = "s2"
east_m = 400.0
north_m = 0.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[[drone]]
name = "d1"

[[drone]]
name = "d2"
departs_s = 10.0
waypoints_m = [[380, 0], [400, 0], [420, 0]]

[[drone]]
name = "d3"
policy = "local-only"
vanishes_s = 40.0
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET)
    return file


def test_each_drone_is_forecast_among_the_others(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(fleet), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    simulated = upwash.simulate_fleet(fleet)
    first, second, gone = found["drones"]
    for forecast, flown in (first, simulated.drones["d1"]), (second, simulated.drones["d2"]):
        times_s = {each["case"]: each["mission_time_s"] for each in forecast["predictions"]}
        assert times_s["as configured"] == flown.mission_time_s < times_s["local-only"]
    assert [each["mission_time_s"] for each in gone["predictions"]] == [None]
    assert (first["waypoints"], second["waypoints"]) == (12, 3)
    assert second["uncovered"] == []


def test_servers_say_how_many_drones_ask_them(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", str(fleet)])
    printed = capsys.readouterr().out
    assert "fleet.toml is understood: 3 drones, 1 service, 2 servers" in printed
    assert "s1: in range of 2 of 3 drones, asked for a slot by 1" in printed
    assert "s2: in range of 1 of 3 drones, asked for a slot by 1" in printed
    assert [line.split()[0] for line in printed.splitlines() if line.startswith(" d")] == [
        *("drone", "d1", "d2", "d3")
    ]
    assert "vanishes" in printed


def test_what_will_hurt_is_said_of_the_drones_that_it_hurts(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(fleet), "--json"]) == 1
    said = [load["text"] for load in json.loads(capsys.readouterr().out)["warnings"]]
    assert any(text.startswith("d1: s2 covers no waypoint") for text in said)
    assert any(text.startswith("d1: the battery lasts 2:55, which is not enough") for text in said)
    assert not any("d3" in text for text in said)


def test_without_anything_to_warn_of_it_ends_well(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = FLEET.replace("endurance_s = 175.0", "").replace("east_m = 400.0", "east_m = 30.0")
    fleet.write_text(text.replace("waypoints_m = [[380, 0], [400, 0], [420, 0]]", ""))
    assert main(["check", str(fleet)]) == 0
    assert "nothing to warn of" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--place 1", "--place-all", "--figures there"])
def test_what_is_of_one_drones_way_is_refused(
    fleet: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    assert main(["check", str(fleet), *option.split()]) == 2
    assert "--place, --place-all and --figures are of one drone's way" in capsys.readouterr().err
