"""What `upwash compare` prints: a table for a person, Markdown for anything else."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from upwash.cli.compare import in_markdown, print_tables
from upwash.cli.main import main
from upwash.lab.campaigns.comparison import ComparedPolicy

SCENARIO = Path(__file__).parents[2] / "scenarios" / "demonstration.toml"


def row(policy: str, minutes: float, margin: float = 0.1, **other: Any) -> ComparedPolicy:
    facts = {
        "scenario": "field",
        "missions": 30,
        "completed": 30,
        "bound_s": 600.0,
        "energy_wh": None,
        "energy_half_width_wh": None,
        **other,
    }
    return ComparedPolicy(policy=policy, mean_s=60 * minutes, half_width_s=60 * margin, **facts)


def printed(*rows: ComparedPolicy) -> list[str]:
    console = Console(width=80, file=io.StringIO(), highlight=False)
    print_tables(rows, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_the_verdict_comes_before_the_rows_and_all_fits_80_columns() -> None:
    lines = printed(
        row("local-only", 20.0),
        row("look-ahead, prepare", 11.0, worst_s=700.0, jain=0.99, energy_wh=60.0, energy_half_width_wh=0.5),
        row("look-ahead", 11.1),
    )
    assert lines[0] == (
        "field: look-ahead, prepare is quickest: 11:00, 10.0 % above the theoretical minimum of 10:00; "
        "1 more is as quick within the margin of error"
    )
    assert all(len(line) <= 80 for line in lines[1:])
    rows = [line for line in lines if " ± 6.0 s" in line]
    policies = [re.split(" {2,}", line[3:].strip())[0] for line in rows]
    assert policies == ["local-only", "look-ahead, prepare", "look-ahead"]
    assert [line[:3].strip() for line in rows] == ["", "*", ""]  # the quickest is marked
    assert any("look-ahead, prepare" in line and "60.00 ± 0.50" in line for line in lines)


def test_drawn_worlds_of_each_kind_stand_below_their_policy() -> None:
    kinds = {"rows, load from 1": (0.5,), "stops": (-0.1, 0.2)}
    lines = printed(
        row("local-only", 20.0),
        row("look-ahead", 11.0, saved_shares=(-0.1, 0.2, 0.5), saved_by_kind=kinds),
        row("mine", 19.0, saved_shares=(0.1,), saved_by_kind={"stops": (0.1,)}),
    )
    *_, rows, stops, mine = (line.split() for line in lines if line.strip())
    assert " ".join(rows) == "rows, load from 1 (1) 50.0 % 1 0 50.0 % 0.0 %"
    assert " ".join(stops[:4]) == "stops (2) 5.0 %"
    assert mine[0] == "mine", "all of one kind"


def test_what_no_battery_lasted_for_is_said() -> None:
    assert printed(row("local-only", float("nan"), completed=0))[0] == "field: no policy completed a mission"
    lines = printed(row("local-only", 20.0, completed=3), row("look-ahead", 11.0))
    assert any("local-only" in line and "3 of 30" in line for line in lines)


def test_others_read_markdown() -> None:
    assert list(in_markdown([row("local-only", 20.0)])) == [
        "| mission time | bound | local-only |",
        "|---|---|---|",
        "| field | 10:00 | 20:00 ± 6.0 s (+100.0 %) |",
    ]
    *_, quickest = in_markdown([row("local-only", 20.0), row("look-ahead", 11.0)])
    assert quickest == "| field | 10:00 | 20:00 ± 6.0 s (+100.0 %) | **11:00 ± 6.0 s (+10.0 %)** |"
    assert "*" not in [*in_markdown([row("local-only", 20.0), row("look-ahead", 20.001)])][-1], "no winner"


def test_flights_are_compared_by_their_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [tmp_path / f"{policy}.jsonl" for policy in ("look-ahead", "local-only")]
    for log in logs:
        assert main(["simulate", str(SCENARIO), "--policy", log.stem, "--log", str(log)]) == 0
    capsys.readouterr()
    assert main(["compare", *map(str, logs)]) == 0
    told = capsys.readouterr().out.splitlines()
    rows = {name: values for name, *values in (re.split(" *[|] *", line.strip("| ")) for line in told)}
    assert rows["policy"] == ["look-ahead", "local-only"]
    assert rows["mission time"] == ["1:36", "1:53"]
    assert told[-1].startswith("look-ahead took 16.9\u00a0s less than local-only")

    renamed = [log.rename(log.with_suffix(".log")) for log in logs]
    assert main(["compare", *map(str, renamed), "--markdown"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert "|  | look-ahead | local-only |" in told
    assert "| mission time | 1:36 | 1:53 |" in told


@pytest.mark.parametrize("more", [["--policy", "look-ahead"], ["--worlds", "3"], [str(SCENARIO)]])
def test_logs_are_compared_without_flying_anything(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(tmp_path / "flight.jsonl"), *more]) == 2
    assert "logs are compared as they are" in capsys.readouterr().err
