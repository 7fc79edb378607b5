"""Missions and services by their path: as a module's name, and as a file."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from upwash.errors import UsageError
from upwash.support.loading import extra, load, look_here, module_command, pip


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "program_for_tests.py"
    file.write_text("class Blind(Exception): ...\ndef survey(drone): ...\n")
    return file


def test_a_name_in_a_module_is_found() -> None:
    assert load("upwash.errors:UsageError") is UsageError


def test_a_name_in_a_file_is_found(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert callable(load(f"{program}:survey"))
    monkeypatch.chdir(program.parent)
    assert callable(load(f"{program.name}:survey"))


def test_a_files_classes_can_be_found_again_by_their_module(program: Path) -> None:
    blind = load(f"{program}:Blind")
    assert isinstance(blind, type)
    assert getattr(sys.modules[blind.__module__], "Blind") is blind  # noqa: B009 - not known to the types


def test_a_mission_and_a_service_in_one_file_share_their_classes(program: Path) -> None:
    blind = load(f"{program}:Blind")
    survey = load(f"{program}:survey")
    assert survey.__globals__["Blind"] is blind  # type: ignore[attr-defined]


def test_files_of_the_same_name_in_different_folders_are_different(program: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / program.name
    other.parent.mkdir()
    other.write_text("class Blind(Exception): ...\n")
    first, second = load(f"{program}:Blind"), load(f"{other}:Blind")
    assert first is not second


@pytest.mark.parametrize("path", ["survey", "upwash.errors", ":survey", "upwash.errors:", ":", ""])
def test_a_path_without_both_parts_is_refused_with_the_form_to_use(path: str) -> None:
    with pytest.raises(UsageError, match=r"package\.module:Name or path/to/file\.py:Name"):
        load(path)


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("no_such_package.at_all:Name", "cannot be loaded from no_such_package.at_all: ModuleNotFoundError"),
        (
            "no_such_package.at_all:Name",
            "set PYTHONPATH to the folder that has it, or write path/to/file.py:Name",
        ),
        ("/no/such/file.py:Name", "cannot be loaded from /no/such/file.py: FileNotFoundError"),
        (".relative:Name", "cannot be loaded from .relative"),
        ("upwash.errors:NoSuchError", "there is no NoSuchError in upwash.errors"),
    ],
)
def test_what_is_not_there_is_named(path: str, said: str) -> None:
    with pytest.raises(UsageError) as refusal:
        load(path)
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def survey(:", "SyntaxError"),
        ("import no_such_package", "No module named 'no_such_package'"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("raise SystemExit('wants to end')", "SystemExit: wants to end"),
        ("\0", "cannot be loaded"),
    ],
)
def test_a_file_that_cannot_be_run_says_why_and_leaves_nothing(program: Path, text: str, said: str) -> None:
    program.with_name("broken_for_tests.py").write_text(text)
    with pytest.raises(UsageError) as refusal:
        load(f"{program.with_name('broken_for_tests.py')}:survey")
    assert said in str(refusal.value)
    assert not [name for name in sys.modules if "broken_for_tests" in name]


def test_a_files_name_may_have_dots(tmp_path: Path) -> None:
    file = tmp_path / "my.service.for.tests.py"
    file.write_text("import dataclasses\n@dataclasses.dataclass\nclass Found:\n    at: 'int'\n")
    assert load(f"{file}:Found") is load(f"{file}:Found")


@pytest.mark.parametrize(
    "text", ["from queue import jobs", "import queue\nqueue.jobs", "import time\ntime.jobs"]
)
def test_a_file_beside_that_python_does_not_find_first_is_named(tmp_path: Path, text: str) -> None:
    for name in ("queue.py", "time.py"):
        (tmp_path / name).write_text("jobs = []\n")
    file = tmp_path / "shadowed_for_tests.py"
    file.write_text(text)
    with pytest.raises(UsageError) as refusal:
        load(f"{file}:Found")
    assert f"{tmp_path / text.split()[1]}.py has the name of a module" in str(refusal.value)
    assert "rename the file" in str(refusal.value)


def test_a_file_of_a_package_is_refused_with_the_names_to_use(tmp_path: Path) -> None:
    folder = tmp_path / "package_for_tests"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "service.py").write_text("from . import helper")
    with pytest.raises(UsageError) as refusal:
        load(f"{folder / 'service.py'}:Found")
    assert f"write package_for_tests.service:Name, and set PYTHONPATH={tmp_path}" in str(refusal.value)


@pytest.mark.parametrize("shadow", ["queue.py", "signal.py", "types.py", "logging.py", "upwash.py"])
def test_a_program_finds_no_modules_in_the_folder_where_it_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shadow: str
) -> None:
    (tmp_path / shadow).write_text("raise SystemExit('found first')")
    monkeypatch.chdir(tmp_path)
    subprocess.run(module_command("upwash.support.text"), check=True)


def test_the_folder_where_a_program_is_started_comes_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["/usr"])
    look_here()
    assert sys.path == ["/usr", str(tmp_path)]


@pytest.mark.parametrize(
    ("receipt", "install", "uninstall"),
    [
        ({}, "pip install 'upwash[docker]'", "pip uninstall onnx"),
        (
            {"pipx_metadata.json": "{}"},
            "pipx runpip upwash install 'upwash[docker]'",
            "pipx runpip upwash uninstall onnx",
        ),
        ({"uv-receipt.toml": ""}, "uv tool install 'upwash[docker]'", "uv pip uninstall --python "),
        (
            {"uv-receipt.toml": '[tool]\nrequirements = [{ name = "upwash", extras = ["detector"] }]\n'},
            "uv tool install 'upwash[detector,docker]'",
            "uv pip uninstall --python ",
        ),
    ],
    ids=["pip", "pipx", "uv", "uv with extras"],
)
def test_hints_name_the_tool_that_installed_upwash(
    receipt: dict[str, str], install: str, uninstall: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    for name, text in receipt.items():
        (tmp_path / name).write_text(text)
    said = re.escape(f"nothing is not installed: `{install}` installs it")
    with pytest.raises(UsageError, match=said), extra("docker"):
        raise ModuleNotFoundError("No module named 'nothing'", name="nothing")
    assert pip("uninstall onnx").startswith(uninstall)
