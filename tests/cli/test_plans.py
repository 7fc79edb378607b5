"""What is left out of a plan is told before anything is flown."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from upwash.cli.main import main

FIELD = Path(__file__).parents[1] / "plans" / "field.plan"
CONFIG = """
[mission]
plan = "field.plan"
[[service]]
name = "detector"
local_call_s = { heavy = 10.0 }
"""
LEFT_OUT = "field.plan: item 2: MAV_CMD_NAV_WAYPOINT (16): its acceptance radius is left out"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    plan = json.loads(FIELD.read_text())
    plan["mission"]["items"][1]["params"][1] = 5
    (tmp_path / "field.plan").write_text(json.dumps(plan))
    (tmp_path / "drone.toml").write_text(CONFIG)
    return tmp_path / "drone.toml"


def test_a_simulation_tells_it_beside_its_result(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(config), "--json"]) == 0
    told = capsys.readouterr()
    assert f"upwash: notice: {config.parent}/{LEFT_OUT}" in told.err
    assert json.loads(told.out)["completed"]


def test_a_flight_tells_it_before_it_connects(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["fly", "--config", str(config), "--log", str(config.parent / "events.jsonl")])
    told = capsys.readouterr().err
    assert told.startswith(f"upwash: notice: {config.parent}/{LEFT_OUT}")


@pytest.mark.parametrize("drones", [1, 2])
def test_a_check_tells_it_and_does_not_warn_of_it(
    config: Path, capsys: pytest.CaptureFixture[str], drones: int
) -> None:
    if drones > 1:
        config.write_text(CONFIG + '[[drone]]\nname = "d1"\n[[drone]]\nname = "d2"\n')
    code = main(["check", str(config), "--json", "--workers", "1"])
    found = json.loads(capsys.readouterr().out)
    assert [LEFT_OUT in notice for notice in found["notices"]] == [True]
    assert code == (1 if found["warnings"] else 0)
    main(["check", str(config), "--workers", "1"])
    assert f"notice: {config.parent}/{LEFT_OUT}" in capsys.readouterr().out


def test_nothing_is_told_of_a_plan_that_is_flown_as_it_says(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(FIELD, config.parent)
    assert main(["simulate", str(config)]) == 0
    assert "notice" not in capsys.readouterr().err
