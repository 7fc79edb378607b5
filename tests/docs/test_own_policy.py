"""The policy that docs/own-policy.md builds, flown as the page says, and the page's figures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.docs.test_docs import ROOT

import upwash

PAGE = (ROOT / "docs/own-policy.md").read_text()
ROWS = re.findall(r"^\| ([a-z-]+) \| [\d.]+ \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", PAGE, re.MULTILINE)


@pytest.fixture
def mine(tmp_path: Path) -> str:
    (program,) = re.findall(r"```python\n(# mine\.py\n.*?)```", PAGE, re.DOTALL)
    (tmp_path / "mine.py").write_text(program)
    return f"{tmp_path / 'mine.py'}:LongestStay"


def test_the_policy_of_the_page_flies_with_reasons(mine: str) -> None:
    run = upwash.simulate(ROOT / "scenarios/dense-city.toml", policy=mine)
    assert run.completed and not run.offloading_failed
    assert run.totals.local < run.totals.calls / 4
    whys = {getattr(event, "why", "") for event in run.events}
    assert any(re.fullmatch(r"in range for \d+ calls", why) for why in whys)


def test_the_extended_policy_of_the_page_flies(tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(# patient\.py\n.*?)```", PAGE, re.DOTALL)
    (tmp_path / "patient.py").write_text(program)
    run = upwash.simulate(ROOT / "scenarios/demonstration.toml", policy=f"{tmp_path / 'patient.py'}:Patient")
    assert run.completed and not run.offloading_failed
    assert {call.decision for call in run.calls if call.place != "local"} >= {"patient"}


def test_the_policy_of_the_page_for_rows_flies(tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(# lines\.py\n.*?)```", PAGE, re.DOTALL)
    (tmp_path / "lines.py").write_text(program)
    rows = ROOT / "scenarios/on-the-move.toml"
    run = upwash.simulate(rows, policy=f"{tmp_path / 'lines.py'}:ServersFirst")
    assert run.completed and not run.offloading_failed
    assert run.totals.local < upwash.simulate(rows).totals.local


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_the_figures_of_the_page_are_those_of_fresh_runs(mine: str, row: tuple[str, ...]) -> None:
    scenario, *minutes = row
    policies = ["location-aware", "look-ahead", mine]
    flown = upwash.compare([ROOT / f"scenarios/{scenario}.toml"], policies=policies, seeds=4, workers=1)
    assert [f"{each.mean_s / 60:.2f}" for each in flown] == minutes


def test_the_page_has_figures() -> None:
    assert [row[0] for row in ROWS] == ["thesis", "dense-city"]
