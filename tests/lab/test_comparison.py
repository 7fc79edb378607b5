"""`upwash compare`: every policy in the same worlds."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.cli import main
from upwash.lab.comparison import ENTRANTS, compare, scenario_worlds, thesis_worlds

ROOT = Path(__file__).parents[2]
LINE = ROOT / "scenarios" / "power-line-light.toml"


def test_each_world_is_flown_by_every_policy_and_the_bound_is_below_all() -> None:
    flown: list[None] = []
    (comparison,) = compare(scenario_worlds([LINE]), seeds=2, workers=2, flown=lambda: flown.append(None))
    assert len(flown) == 2 * len(ENTRANTS)
    times_s = {policy: mean.value for policy, mean in comparison.mission_time_s.items()}
    assert list(times_s) == [entrant.name for entrant in ENTRANTS]
    names = ["look-ahead, prepare", "look-ahead", "location-aware", "local-only"]
    in_order_s = [comparison.bound_s, *(times_s[name] for name in names)]
    assert in_order_s == sorted(in_order_s)
    assert times_s["look-ahead, prepare"] < 1.03 * comparison.bound_s
    assert all(mean.count == 2 and mean.margin > 0 for mean in comparison.mission_time_s.values())


def test_the_thesis_has_eight_cells() -> None:
    worlds = thesis_worlds()
    assert len({world.name for world in worlds}) == 8
    assert {(world.config.mission.mode) for world in worlds} == {"light", "heavy"}


def test_the_command_prints_a_table_that_can_be_put_on_a_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(LINE), "--seeds", "1", "--workers", "1"]) == 0
    heading, rule, row = capsys.readouterr().out.splitlines()
    assert heading.count("|") == rule.count("|") == row.count("|") == 3 + len(ENTRANTS)
    assert row.startswith("| power-line-light | ")


def test_nothing_to_compare_in_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare"]) == 2
    assert "--thesis" in capsys.readouterr().err
