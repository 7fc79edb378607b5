"""Photos of a rendered camera in a simulation: none is rendered that nobody looks at."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from upwash.cli.main import main

SCENARIO = """[mission]
program = "survey"
waypoints_m = [[0, 0], [40, 0], [40, 40]]
altitude_m = 70.0
[camera]
park_seed = 3
[[service]]
name = "detector"
local_call_s = { heavy = 6.0, light = 3.0 }
"""


@pytest.fixture(autouse=True)
def renderer_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a photo was rendered")

    monkeypatch.setattr("upwash.services.solar_park.photograph", refuse)


def scenario(folder: Path) -> str:
    file = folder / "park.toml"
    file.write_text(SCENARIO)
    return str(file)


@pytest.mark.parametrize(
    "command", ["check", "simulate", "compare --seeds 1 --workers 1 --policy local-only"]
)
def test_no_photo_is_rendered_that_nobody_looks_at(command: str, tmp_path: Path) -> None:
    name, *options = command.split()
    assert main([name, scenario(tmp_path), *options]) == 0


def test_a_simulated_photo_has_the_size_of_a_rendered_photo(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    assert main(["simulate", scenario(tmp_path), "--json", "--log", str(log)]) == 0
    photos = [
        event for line in log.read_text().splitlines() if (event := json.loads(line))["event"] == "photo"
    ]
    assert len(photos) == 3
    assert all(photo["bytes"] == 430_000 for photo in photos)
