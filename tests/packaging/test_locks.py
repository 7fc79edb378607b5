"""The two locks: what running needs is part of what developing needs, at the same versions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def pins(lock: str) -> dict[str, str]:
    """Each pinned package with its versions' markers, and its hashes."""
    text = (ROOT / lock).read_text().replace("\\\n", "")
    return {
        line.split("--hash")[0].strip(): line.partition("--hash")[2] for line in text.splitlines() if line
    }


def test_what_runs_is_pinned_alike_where_it_is_developed() -> None:
    run, develop = pins("requirements-run.lock"), pins("requirements.lock")
    versions = {re.split(r"[ ;]", pin)[0] for pin in develop}
    assert {re.split(r"[ ;]", pin)[0] for pin in run} <= versions
    assert all(hashes for hashes in run.values())


def test_running_needs_nothing_that_only_developers_use() -> None:
    names = {pin.split("==")[0] for pin in pins("requirements-run.lock")}
    assert names & {"pytest", "mypy", "selenium", "mavsdk", "pyarrow", "matplotlib", "distributed"} == set()
    assert {"grpcio", "pymavlink", "onnxruntime", "opencv-python-headless", "starlette"} <= names


def test_servers_and_drones_get_the_versions_of_the_tests() -> None:
    assert list(pins("deploy/constraints.txt")) == list(pins("requirements.lock"))


@pytest.mark.parametrize("place", ["docs/*.md", "training/*.md", "deploy/*", "examples/*/Containerfile"])
def test_what_installs_the_folder_takes_the_locks_versions(place: str) -> None:
    installs = r"pip install .*(?:\\\n.*)?[\"'](?:\.|/src|\./upwash|\$source)\[.*"
    files = (file for file in ROOT.glob(place) if file.is_file())
    found = [line for file in files for line in re.findall(installs, file.read_text())]
    assert found
    assert [line for line in found if "constraints.txt" not in line] == []
