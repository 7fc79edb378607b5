"""The examples run, without hardware."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import tomli_w
from tests.programs import ROOT, ended, upwash

from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.missions.bundled import load_services
from upwash.rpc.service import spec_of

EXAMPLES = ROOT / "examples"
SCENARIOS = sorted(file for file in EXAMPLES.glob("*.toml") if "[mission]" in file.read_text())


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_an_example_is_flown_on_the_drone_and_on_its_server(scenario: Path) -> None:
    run = upwash("simulate", scenario, "--json")
    assert run.returncode == 0, run.stderr
    totals = msgspec.json.decode(run.stdout)["totals"]
    assert (totals["local"] > 0) == (scenario.stem != "segmenter")  # which only servers run
    assert totals["remote"]["s1"] > 0


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_mission_that_a_reader_sees_first_flies_past_both_servers(page: str, tmp_path: Path) -> None:
    (mission,) = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)
    (tmp_path / "mission.py").write_text(mission)
    scenario = tomllib.loads((ROOT / "scenarios/demonstration.toml").read_text())
    scenario["mission"] |= {"program": "mission.py:survey"}
    del scenario["mission"]["mode"]
    (tmp_path / "scenario.toml").write_text(tomli_w.dumps(scenario))
    run = upwash("simulate", tmp_path / "scenario.toml", "--json")
    assert run.returncode == 0, run.stderr
    totals = msgspec.json.decode(run.stdout)["totals"]
    assert totals["local"] > 0
    assert set(totals["remote"]) == {"s1", "s2"}


def test_a_notebook_shows_what_a_server_is_worth_in_any_folder(tmp_path: Path) -> None:
    run = ended([sys.executable, EXAMPLES / "notebook.py"], tmp_path)
    assert run.returncode == 0, run.stderr
    alone, offloading, *_ = (line for line in run.stdout.splitlines() if "calls on the drone" in line)
    assert alone.endswith("5 of 5 calls on the drone")
    assert offloading.endswith("1 of 5 calls on the drone")
    means_s = {
        tuple(words[:3:2]): float(words[3])
        for line in run.stdout.splitlines()
        if len(words := line.split()) > 7 and words[1] == "m"
    }
    assert len(means_s) == 6
    for range_m in ("20", "40", "80"):
        assert means_s[range_m, "look-ahead"] < means_s[range_m, "local-only"]
    assert means_s["80", "look-ahead"] < means_s["20", "look-ahead"]


@pytest.fixture
def beetle_counters() -> Iterator[tuple[type, type]]:
    """The drone's and the server's, as their configurations name them."""
    drone = load_services(read_drone_config(EXAMPLES / "pests.toml").services)
    daemon = load_services(read_daemon_config(EXAMPLES / "pests_server.toml").images)
    yield drone["beetlecounter"].cls, daemon["beetlecounter"].cls
    sys.path.remove(str(EXAMPLES))


def test_what_the_drone_asks_its_counter_is_understood_by_the_other_one_on_the_server(
    beetle_counters: tuple[type, type],
) -> None:
    for asked, asking in (beetle_counters, reversed(beetle_counters)):
        stub, instance = spec_of(asking).methods["count"], spec_of(asked).methods["count"]
        _, request = stub.encode((_leaf(beetles=12),), {})
        found = stub.result(stub.decode(instance.perform(asked(), request)[1]))
        assert getattr(found, "number", None) == pytest.approx(12, abs=1)


def test_the_server_counts_beetles_that_the_drone_only_estimates(beetle_counters: tuple[type, type]) -> None:
    on_drone, on_server = (counter().count(_leaf(beetles=60)) for counter in beetle_counters)
    assert on_server.counted
    assert on_server.number == 60
    assert not on_drone.counted
    assert on_drone.number == pytest.approx(60, rel=0.1)


def _leaf(*, beetles: int) -> bytes:
    """A photo of that many red ellipses in rows, each its own way round, on a noisy green."""
    noise = np.random.default_rng(1)
    image = np.full((600, 800, 3), (60, 140, 70), np.uint8) + noise.integers(
        0, 20, (600, 800, 3), dtype=np.uint8
    )
    for number in range(beetles):
        row, column = divmod(number, 10)
        place = (50 + 70 * column, 50 + 80 * row)
        cv2.ellipse(image, place, (8, 6), 17.0 * number, 0, 360, (30, 30, 200), -1)
    return bytes(cv2.imencode(".jpg", image)[1])
