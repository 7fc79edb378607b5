"""Fingerprints of services: what is another version of one, and what is not."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from upwash.ports import Program
from upwash.real.instances import versions
from upwash.real.instances.versions import version_of, version_of_upwash


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (
        "mine.py",
        "beside.py",
        "package/__init__.py",
        "package/deep/part.py",
        "data/x.bin",
        "model/w.bin",
    ):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("1")
    return tmp_path


def version(folder: Path) -> str:
    settings = {"model": str(folder / "model"), "threads": 2, "nested": [{"list": str(folder / "names.txt")}]}
    return version_of(Program(f"{folder}/mine.py:Mine", settings), [folder / "readable.txt"])


@pytest.mark.parametrize(
    "name",
    [
        "mine.py",
        "beside.py",
        "package/__init__.py",
        "package/deep/part.py",
        "model/w.bin",
        "model/new.bin",
        "names.txt",
        "readable.txt",
        "another.py",
    ],
)
def test_another_content_of_what_a_service_is_made_of_is_another_version(folder: Path, name: str) -> None:
    before = version(folder)
    (folder / name).write_text("2")
    assert version(folder) != before


def touch(folder: Path) -> None:
    (folder / "mine.py").touch()


def compile_it(folder: Path) -> None:
    (folder / "package/__pycache__").mkdir()
    (folder / "package/__pycache__/part.pyc").write_text("2")


def edit_a_backup(folder: Path) -> None:
    (folder / "model/.w.bin.swp").write_text("2")


def write_what_it_does_not_read(folder: Path) -> None:
    (folder / "data/x.bin").write_text("2")
    (folder / "notes.txt").write_text("2")


@pytest.mark.parametrize("change", [touch, compile_it, edit_a_backup, write_what_it_does_not_read])
def test_what_it_does_not_read_is_no_other_version(folder: Path, change: Callable[[Path], None]) -> None:
    before = version(folder)
    change(folder)
    assert version(folder) == before


def test_the_same_files_are_the_same_version_on_another_machine_in_another_folder(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = shutil.copytree(folder, tmp_path_factory.mktemp("elsewhere") / "services")
    assert version(elsewhere) == version(folder)


def test_files_that_change_places_are_another_version(folder: Path) -> None:
    (folder / "model/w.bin").write_text("2")
    models = [folder / "model/w.bin", folder / "data/x.bin"]
    program = Program("no.such:Module", {str(number): str(model) for number, model in enumerate(models)})
    before = version_of(program)
    first, second = (model.read_text() for model in models)
    models[0].write_text(second)
    models[1].write_text(first)
    assert version_of(program) != before


def test_of_files_beyond_what_is_read_the_size_and_the_time_of_their_change_count(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(versions, "_MOST_READ_BYTES", 2)  # those of the two first files
    before = version(folder)
    weights = folder / "model/w.bin"
    os.utime(weights, ns=(1, weights.stat().st_mtime_ns))
    assert version(folder) == before
    os.utime(weights, ns=(1, 2))
    assert version(folder) != before


def test_what_cannot_be_read_is_no_error(folder: Path) -> None:
    (folder / "gone.py").symlink_to(folder / "nowhere")
    os.mkfifo(folder / "model/pipe")
    assert version(folder) == version(folder)


def test_a_bundled_service_changes_with_upwash_alone(folder: Path) -> None:
    assert version_of(Program("upwash.services:Detector")) == version_of(Program("no.such:Module"))
    assert version_of_upwash() == version_of_upwash()
