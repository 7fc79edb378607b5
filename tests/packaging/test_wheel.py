"""The wheel has all that a user needs who has no copy of the repository."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel's content, to be imported in place of this repository's."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = (folder / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "installed")
    return folder / "installed"


def upwash(installed: Path, folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "upwash", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_project_is_made_checked_and_simulated_from_the_wheel_alone(
    installed: Path, tmp_path: Path
) -> None:
    upwash(installed, tmp_path, "init", "project")
    assert "nothing to warn of" in upwash(installed, tmp_path, "check", "project/drone.toml")
    assert "6 of 6 waypoints reached" in upwash(installed, tmp_path, "simulate", "project/drone.toml")


def test_it_lacks_no_file_of_the_package(installed: Path) -> None:
    """Whatever lies beside the code: models, templates, pages, scripts."""
    source = ROOT / "src" / "upwash"
    files = {
        file.relative_to(source)
        for file in source.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and not file.name.startswith(".")
    }
    assert not [name for name in sorted(files) if not (installed / "upwash" / name).exists()]
