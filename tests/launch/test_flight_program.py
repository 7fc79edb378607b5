"""`upwash fly` as a process beside this one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from upwash.launch.processes import INTERRUPTED, FlightProgram

pytestmark = pytest.mark.system


async def test_what_it_prints_is_told_and_its_exit_code_is_returned(tmp_path: Path) -> None:
    told: list[str] = []
    program = FlightProgram(tmp_path / "missing.toml", tmp_path / "log.jsonl", say=told.append)
    assert await program.run() == 2
    (said,) = told
    assert said.startswith("upwash: ") and "missing.toml" in said


async def test_a_line_of_any_length_ends_nothing(tmp_path: Path) -> None:
    told: list[str] = []
    prints = (sys.executable, "-c", "print('x' * 200_000); print('last')")
    program = FlightProgram(tmp_path / "a.toml", tmp_path / "log.jsonl", say=told.append, through=prints)
    assert await program.run() == 0
    assert "".join(told) == "x" * 200_000 + "last"


async def test_one_that_was_stopped_before_does_not_start(tmp_path: Path) -> None:
    told: list[str] = []
    program = FlightProgram(tmp_path / "missing.toml", tmp_path / "log.jsonl", say=told.append)
    program.stop()
    assert await program.run() == INTERRUPTED
    assert told == []
