"""The page of lighter calls: its table beside fresh runs, and what commands say of such a mission."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from bench.lighter import BUDGETS_S, CALLS, SCENARIO, Flown, first, heavy_then_light, planned

import upwash
from upwash.cli.main import main

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "calls.md").read_text(encoding="utf-8")
SHOWN = re.findall(
    r"^\| (\d+) \|" + r" (\d+) \| ([\d.]+) s \| ([\d.]+) \|" * 2 + "$", PAGE, flags=re.MULTILINE
)
ROWS = [
    ("1450", "116", "1446.9", "0.985", "112", "1446.1", "0.984"),
    *SHOWN,
    ("1320", "25", "1319.9", "0.951", "1", "1316.9", "0.941"),
    ("1300", "0", "1309.9", "0.941", "0", "1309.9", "0.941"),
]


def cells(flown: Flown) -> tuple[str, str, str]:
    return str(flown.heavy), f"{flown.mission_time_s:.1f}", f"{flown.mean_ap50:.3f}"


def test_every_budget_is_flown() -> None:
    assert SHOWN
    assert [int(row[0]) for row in ROWS] == list(BUDGETS_S)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_the_page_says_what_is_flown(row: tuple[str, ...]) -> None:
    budget_s = int(row[0])
    calm, hurried = planned(budget_s), first(budget_s)
    assert row[1:4] == cells(calm)
    assert row[4:7] == cells(hurried)
    assert calm.heavy >= hurried.heavy
    if calm.heavy > 0:
        assert calm.mission_time_s <= budget_s
    else:
        assert calm.mission_time_s == hurried.mission_time_s, "all are light"


def test_the_page_has_the_mission_as_it_is_asked_for_and_all_light() -> None:
    for flown in (heavy_then_light(CALLS), heavy_then_light(0)):
        assert f"{flown.mission_time_s:.1f} s" in PAGE


def hurried(tmp_path: Path, finish_by_s: float) -> Path:
    file = tmp_path / "hurried.toml"
    keys = f'mode = "heavy"\nfinish_by_s = {finish_by_s}\nlighter = {{ heavy = "light" }}\n'
    file.write_text(SCENARIO.read_text().replace('mode = "heavy"\n', keys))
    return file


def test_the_summary_and_the_explanation_are_as_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.jsonl"
    assert main(["simulate", str(hurried(tmp_path, 1372.0)), "--log", str(log)]) == 0
    assert "105 heavy, 16 light" in capsys.readouterr().out
    assert "105 heavy, 16 light" in PAGE
    assert main(["explain", str(log)]) == 0
    quoted = (
        "detector.process_photo[heavy] was asked for: so the mission would have ended at 24:39, 107.9 s later"
    )
    assert quoted in capsys.readouterr().out
    assert main(["report", str(log), "--out", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text()
    assert '<th scope="row">calls lighter than asked for</th><td>16</td>' in page


@pytest.mark.parametrize(("finish_by_s", "late"), [(1372.0, False), (1300.0, True)])
def test_the_check_says_how_many_calls_are_lighter_and_whether_that_is_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], finish_by_s: float, late: bool
) -> None:
    main(["check", str(hurried(tmp_path, finish_by_s)), "--workers", "1"])
    said = capsys.readouterr().out
    (configured,) = (line for line in said.splitlines() if line.startswith("  as configured"))
    assert configured.split()[-1] == ("121" if late else "16")
    if not late:
        (without,) = (line for line in said.splitlines() if line.startswith("  without s1"))
        assert f"with {without.split()[-1]} of 121 calls light" in " ".join(PAGE.split())
    warning = next(line for line in said.splitlines() if line.startswith("warning: mission.finish_by_s"))
    assert ("as configured (21:49)" in warning) == late


def test_a_campaign_varies_the_time_and_counts(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    command = ["campaign", str(SCENARIO), "--seeds", "1", "--workers", "1", "--out", str(file)]
    settings = ["--set", "mission.finish_by_s=1372,1336", "--set", "mission.lighter.heavy=light"]
    assert main([*command, *settings]) == 0
    head, *rows = (line.split(",") for line in file.read_text().splitlines())
    assert [row[head.index("lighter")] for row in rows] == ["16", "56"]


def test_the_settings_on_the_page_are_understood() -> None:
    _, section = PAGE.split("## Lighter calls")
    block = re.findall(r"```toml\n(.*?)```", section, flags=re.DOTALL)[0]
    text = SCENARIO.read_text().replace("[mission]\n", block)
    flight = upwash.simulate(tomllib.loads(text))
    assert flight.totals.lighter == 16
