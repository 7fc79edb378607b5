"""The examples run, without hardware."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("scenario", sorted((ROOT / "examples").glob("*.toml")), ids=lambda path: path.stem)
def test_an_example_is_flown_on_the_drone_and_on_its_server(scenario: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "upwash", "simulate", str(scenario), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    totals = msgspec.json.decode(run.stdout)["totals"]
    assert totals["local"] > 0
    assert totals["remote"]["s1"] > 0
