"""Campaigns and comparisons of several drones: a row is a flight of all of them."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

import upwash
from upwash.cli.main import main
from upwash.errors import ConfigError
from upwash.lab.campaigns.sweep import read_sweep

FLEET = """
[mission]
grid = { columns = 3, rows = 3, spacing_m = 20.0 }

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 20.0
north_m = 20.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 2.0 }

[noise]
call = 0.1
leg = 0.1

[[drone]]
name = "d1"
policy = "location-aware"

[[drone]]
name = "d2"

[[drone]]
name = "d3"
vanishes_s = 60.0
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET)
    return file


def campaign(fleet: Path, *options: str) -> list[dict[str, str]]:
    out = fleet.with_name("rows.csv")
    command = ["campaign", str(fleet), "--seeds", "2", "--workers", "1", "--out", str(out), *options]
    assert main(command) == 0
    with out.open(newline="") as lines:
        return list(csv.DictReader(lines))


def test_the_number_of_drones_is_varied_and_a_row_is_of_all_of_them(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = campaign(fleet, "--set", "drones=1,3")
    assert [(row["drones"], row["seed"], row["completed_drones"]) for row in rows] == [
        *(("1", seed, "1") for seed in "12"),
        *(("3", seed, "2") for seed in "12"),
    ]
    simulated = upwash.simulate_fleet(fleet, seed=2)
    row = rows[3]
    assert (row["seed"], row["completed"], row["policy"]) == ("2", "true", "location-aware look-ahead")
    assert simulated.bound is not None
    for column, value in {
        "mission_time_s": simulated.mean_s,
        "worst_s": simulated.worst_s,
        "jain": simulated.jain,
        "bound_s": simulated.bound.free_s,
        "bound_shared_s": simulated.bound.shared_s,
    }.items():
        assert float(row[column]) == value
    assert int(row["calls"]) == sum(each.totals.calls for each in simulated.drones.values())
    printed = capsys.readouterr().out
    assert f"{simulated.jain:.1f}" in printed.split("fairness")[1]
    assert printed.index("quickest with drones=") < printed.index("completed"), "the verdict comes first"
    (quickest,) = re.findall(r"quickest with drones=(\d+)", printed)
    assert re.findall(r"^ \* +(\d+) ", printed, re.MULTILINE) == [quickest], "its row has a mark"


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("drones=2,4", "drones: 4 are more than the file has: 3 .* tables: add some, or ask for fewer"),
        ("drones=0", "drones: expected a number of drones from 1 on, found 0"),
        ("drones=true", "drones: expected a number of drones from 1 on, found true"),
    ],
)
def test_more_drones_than_the_file_has_are_refused(fleet: Path, setting: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_sweep(fleet, [setting], seeds=1)


def test_a_drone_is_set_by_its_name_and_the_number_of_drones_in_python_too(fleet: Path) -> None:
    simulated = upwash.simulate_fleet(fleet, overrides={"drones": 2, "drone.d2.departs_s": 50.0})
    assert list(simulated.drones) == ["d1", "d2"]
    assert simulated.drones["d2"].events[0].t == 50.0


def test_a_comparison_of_several_drones_has_the_worst_and_how_even_it_was(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    local, ahead = upwash.compare([fleet], policies=["local-only", "look-ahead"], seeds=2, workers=1)
    fleets = [upwash.simulate_fleet(fleet, policy="look-ahead", seed=seed) for seed in (1, 2)]
    times_s = [each.mean_s for each in fleets if each.mean_s is not None]
    assert ahead.mean_s == pytest.approx(sum(times_s) / 2)
    worst_s = [each.worst_s for each in fleets if each.worst_s is not None]
    assert ahead.worst_s == pytest.approx(sum(worst_s) / 2)
    assert ahead.jain is not None and 0.5 <= ahead.jain <= 1.0 and local.jain == 1.0
    assert ahead.bound_s == local.bound_s < ahead.mean_s < local.mean_s
    assert (ahead.missions, ahead.completed) == (2, 2)
    assert main(["compare", str(fleet), "--seeds", "1", "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    assert "| worst time, fairness (Jain's index) | local-only |" in printed


def test_without_several_drones_there_is_neither() -> None:
    patrol = Path(__file__).parents[2] / "examples" / "patrol.toml"
    (row,) = upwash.compare([patrol], policies=["look-ahead"], seeds=1, workers=1)
    assert (row.worst_s, row.jain) == (None, None)
