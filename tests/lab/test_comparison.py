"""`upwash compare`: every policy in the same scenarios."""

from __future__ import annotations

from pathlib import Path

import pytest

import upwash
from upwash.cli.main import main
from upwash.lab import processes
from upwash.lab.campaigns.comparison import ENTRANTS, thesis_scenarios
from upwash.support.text import lasting

ROOT = Path(__file__).parents[2]
LINE = ROOT / "scenarios" / "power-line-light.toml"
PATROL = ROOT / "examples" / "patrol.toml"


def test_each_world_is_flown_by_every_policy_and_the_bound_is_below_all() -> None:
    told: list[tuple[int, int]] = []
    rows = upwash.compare([LINE], seeds=2, workers=2, progress=lambda *counts: told.append(counts))
    count = 2 * len(ENTRANTS)
    assert told == [(done, count) for done in range(1, count + 1)]
    assert [(row.scenario, row.policy) for row in rows] == [(LINE.stem, entrant.name) for entrant in ENTRANTS]
    times_s = {row.policy: row.mean_s for row in rows}
    (bound_s,) = {row.bound_s for row in rows}
    names = ["look-ahead, prepare", "look-ahead", "location-aware", "local-only"]
    in_order_s = [bound_s, *(times_s[name] for name in names)]
    assert in_order_s == sorted(in_order_s)
    assert times_s["look-ahead, prepare"] < 1.03 * bound_s
    assert all(row.missions == 2 and row.half_width_s > 0 for row in rows)


def test_one_worker_is_the_calling_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_WORTH_STARTING_S", 0.0)
    monkeypatch.delattr(processes, "in_processes")
    (row,) = upwash.compare([PATROL], policies=["look-ahead"], seeds=2, workers=1)
    assert row.missions == 2


def test_scenarios_may_have_names_of_their_own_and_be_tables() -> None:
    tables = {
        "mission": {"program": f"{PATROL.parent}/patrol.py:patrol", "waypoints_m": [(0, 0), (20, 0)]},
        "service": [
            {"name": "counter", "program": f"{PATROL.parent}/patrol.py:Counter", "local_call_s": 6.0}
        ],
    }
    policies = ["look-ahead", "local-only"]
    rows = upwash.compare({"with": PATROL, "without": tables}, policies=policies, seeds=1)
    assert [(row.scenario, row.policy) for row in rows] == [
        *(("with", policy) for policy in policies),
        *(("without", policy) for policy in policies),
    ]
    with_servers, local, *without = (row.mean_s for row in rows)
    assert with_servers < local
    assert without[0] == without[1]


def test_drawn_worlds_are_one_case_with_what_each_saved() -> None:
    policies = ["local-only", "look-ahead"]
    local, ahead = upwash.compare(worlds=range(7, 10), policies=policies, seeds=1, workers=1)
    assert (local.scenario, local.missions, local.saved_shares) == ("worlds 7..9", 3, ())
    times_s = [
        [upwash.simulate(upwash.draw_world(seed), policy=policy).mission_time_s for policy in policies]
        for seed in range(7, 10)
    ]
    assert ahead.saved_shares == pytest.approx(sorted(1 - after / before for before, after in times_s))
    seventh, eighth, ninth = (1 - after / before for before, after in times_s)
    assert ahead.saved_by_kind["rows, load below 1"] == pytest.approx((eighth,))
    assert ahead.saved_by_kind["stops"] == pytest.approx(sorted((seventh, ninth)))
    assert not local.saved_by_kind
    assert ahead.bound_s < ahead.mean_s == pytest.approx(sum(after for _, after in times_s) / 3)


def test_worlds_and_surveys_are_told_apart_and_each_of_them_by_kind(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = ["--surveys", "7..8", "--worlds", "4..5", "--policy", "local-only", "--policy", "look-ahead"]
    assert main(["compare", *given, "--workers", "1", "--figures", str(tmp_path)]) == 0
    assert {file.name for file in tmp_path.iterdir()} == {"compare.png", "worlds.png", "surveys.png"}
    lines = capsys.readouterr().out.splitlines()
    heading = next(number for number, line in enumerate(lines) if "beside local-only" in line)
    assert [line.split(" | ")[0] for line in lines[heading + 2 : heading + 8]] == [
        "| look-ahead, worlds 4..5",
        "| look-ahead, worlds 4..5, rows, load from 1 (1)",
        "| look-ahead, worlds 4..5, stops (1)",
        "| look-ahead, surveys 7..8",
        "| look-ahead, surveys 7..8, rows, load below 1 (1)",
        "| look-ahead, surveys 7..8, rows, load from 1 (1)",
    ]


def test_the_command_sets_losses_beside_gains(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    given = ["--worlds", "4..5", "--policy", "look-ahead", "--policy", "local-only", "--workers", "1"]
    assert main(["compare", *given, "--figures", str(tmp_path)]) == 0
    assert {file.name for file in tmp_path.iterdir()} == {"compare.png", "worlds.png"}
    lines = capsys.readouterr().out.splitlines()
    heading = next(line for line in lines if "beside look-ahead" in line)
    cells = lines[lines.index(heading) + 2].split(" | ")
    assert cells[2:4] == ["0", "2"]
    assert float(cells[5].split()[0]) > 0


def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    (tmp_path / PATROL.name).write_text(PATROL.read_text())
    with pytest.raises(upwash.UsageError, match=r'"look-ahaed"; did you mean "look-ahead"\?'):
        upwash.compare([PATROL], policies=["look-ahaed"])
    with pytest.raises(upwash.UsageError, match="two scenarios are called patrol"):
        upwash.compare([PATROL, tmp_path / PATROL.name])
    with pytest.raises(upwash.UsageError, match="0 seeds"):
        upwash.compare([PATROL], seeds=0)
    with pytest.raises(upwash.ConfigError, match=r"server\.s1\.range_m: expected a finite number"):
        upwash.compare([PATROL], overrides={"server.s1.range_m": float("inf")})


def test_the_thesis_has_eight_cells() -> None:
    scenarios = thesis_scenarios()
    assert len({scenario.name for scenario in scenarios}) == 8
    assert {(scenario.config.mission.mode) for scenario in scenarios} == {"light", "heavy"}


def test_the_command_prints_a_table_that_can_be_put_on_a_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(LINE), "--seeds", "1", "--workers", "1"]) == 0
    heading, rule, row = capsys.readouterr().out.splitlines()
    assert heading.count("|") == rule.count("|") == row.count("|") == 3 + len(ENTRANTS)
    assert row.startswith("| power-line-light | ")


def test_nothing_to_compare_in_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare"]) == 2
    assert "--thesis" in capsys.readouterr().err


def test_a_comparison_of_drones_that_go_says_how_often_they_turned_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = tmp_path / "line.toml"
    scenario.write_text(LINE.read_text() + "\n[event]\nevery = 9\n")
    options = ["--seeds", "1", "--workers", "1"]
    assert main(["compare", str(scenario), "--set", "policy.stay_or_go=go", *options]) == 0
    head, rule, row = capsys.readouterr().out.splitlines()[-3:]
    assert head.startswith("| turned back, hidden time | local-only | ")
    assert row.count("|") == rule.count("|") == 2 + len(ENTRANTS)
    rows = upwash.compare([scenario], seeds=1, workers=1, overrides={"policy.stay_or_go": "go"})
    assert all(each.turned_back and each.hidden_s for each in rows)
    assert f"| {rows[0].turned_back:.1f}, {lasting(rows[0].hidden_s or 0)} |" in row


@pytest.mark.parametrize("settings", [["policy.stay_or_go=go,stay"], ["seed=1"], ["mission.mode=light"] * 2])
def test_a_comparison_takes_one_value_of_a_key(
    capsys: pytest.CaptureFixture[str], settings: list[str]
) -> None:
    given = [word for setting in settings for word in ("--set", setting)]
    assert main(["compare", str(LINE), *given]) == 2
    assert settings[0].partition("=")[0] in capsys.readouterr().err
