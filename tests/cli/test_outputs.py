"""No output of a command replaces one of its inputs, or another output; every option with a path says which it is."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from upwash.cli.arguments import filled_path, read_path, written_path
from upwash.cli.main import command_line, main

KINDS = {read_path: "read", written_path: "written", filled_path: "filled"}
PATHS = {
    "init": {"folder": "filled"},
    "fly": {"--config": "read", "--log": "written", "--resume": "written"},
    "check": {"config": "read", "--figures": "filled"},
    "ros": {"--config": "read", "--log": "written"},
    "serve": {"--config": "read"},
    "status": {"--inventory": "read", "--keys": "read"},
    "keys": {"folder": "filled", "--signing": "written"},
    "package": {"--output": "filled", "--config": "read", "--include": "read"},
    "images": {"--config": "read"},
    "profile": {"--photos": "read", "--config": "read", "--labels": "read", "--out": "written"},
    "vehicle": {"--signing-key": "read"},
    "demo": {"--folder": "filled", "--runtime": "read"},
    "simulate": {"scenario": "read", "--log": "written", "--figures": "filled"},
    "view": {"logs": "read", "--scenario": "read", "--photos": "read"},
    "report": {
        **dict.fromkeys(("logs", "--scenario", "--photos", "--labels"), "read"),
        **dict.fromkeys(
            ("--out", "--csv", "--geojson", "--findings", "--mcap", "--bag", "--dataset", "--export"),
            "written",
        ),
    },
    "reproduce": {"--figures": "filled", "--json": "written"},
    "campaign": {"scenario": "read", "--out": "written", "--figures": "filled"},
    "compare": {"scenarios": "read", "--figures": "filled"},
    "traces": {"log": "read", "--out": "filled"},
    "worlds": {"--out": "filled"},
    "whatif": {"logs": "read"},
    "explain": {"log": "read", "--scenario": "read"},
    "chaos": {"--out": "written", "--log": "written"},
    "emulate": {"scenarios": "read", "--folder": "filled"},
    "goodput": {"--out": "written"},
}


@cache
def actions() -> list[tuple[str, argparse.Action]]:
    """Each argument of each command."""
    (commands,) = (
        action for action in command_line()._actions if isinstance(action, argparse._SubParsersAction)
    )
    return [(name, action) for name, parser in commands.choices.items() for action in parser._actions]


def name_of(action: argparse.Action) -> str:
    return action.option_strings[-1] if action.option_strings else action.dest


def test_each_path_among_the_options_is_read_written_or_filled() -> None:
    found: dict[str, dict[str, str]] = {}
    for command, action in actions():
        assert action.type is not Path, f"{command} {name_of(action)}: reads, writes or fills"
        if action.type in KINDS:
            found.setdefault(command, {})[name_of(action)] = KINDS[action.type]
    assert found == PATHS


def given(command: str, *named: str, path: str) -> list[str]:
    """The command with its needed arguments, and these of a path."""
    words = [command]
    for each, action in actions():
        if each != command:
            continue
        name = name_of(action)
        if name in named:
            kind = ["kind"] if action.nargs == 2 else []
            words += [path] if not action.option_strings else [name, *kind, path]
        elif action.required or (not action.option_strings and action.nargs not in ("?", "*", 0)):
            needed = action.choices and next(iter(action.choices))
            words += [name] if action.option_strings else []
            words.append(str(needed or ("1" if action.type not in (None, *KINDS) else "other")))
    return words


PAIRS = [
    (command, (one, other))
    for command, paths in PATHS.items()
    for place, (one, kind) in enumerate(paths.items())
    for other, its in list(paths.items())[:place]
    if "written" in (kind, its) and (one, other) != ("--resume", "--log")
]


@pytest.mark.parametrize(("command", "pair"), PAIRS)
def test_no_file_is_input_and_output_or_two_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, pair: tuple[str, str]
) -> None:
    file = tmp_path / "only.jsonl"
    file.write_text("the only record")
    words = given(command, *pair, path=str(file))
    words += ["--seeds", "1"] if command == "chaos" else []
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "name another" in said or "is a file: give the name of a folder" in said
    assert file.read_text() == "the only record"
    assert list(tmp_path.iterdir()) == [file]


def linked(file: Path) -> Path:
    link = file.with_name("link")
    link.symlink_to(file)
    return link


def hard_linked(file: Path) -> Path:
    link = file.with_name("hard")
    link.hardlink_to(file)
    return link


def through_a_folder(file: Path) -> Path:
    (file.parent / "linked").symlink_to(file.parent)
    return file.parent / "linked" / "." / "linked" / ".." / file.parent.name / file.name


@pytest.mark.parametrize("other_name", [linked, hard_linked, through_a_folder])
def test_a_file_by_another_name_is_the_same(tmp_path: Path, other_name: Callable[[Path], Path]) -> None:
    file = tmp_path / "flight.jsonl"
    file.write_text("the only record")
    assert main(["report", str(file), "--csv", str(other_name(file))]) == 2
    assert file.read_text() == "the only record"


@pytest.mark.parametrize(
    "outputs",
    [
        "--csv a.out --geojson ./A.out",
        "--csv flown/calls.csv --bag flown",
        "--photos . -o 1.JPG",
        "--mcap photos",
    ],
)
def test_outputs_in_the_place_of_another_or_of_a_photo_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, outputs: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("1.JPG").write_bytes(b"a photo")
    Path("photos").mkdir()
    assert main(["report", "flight.jsonl", *outputs.split()]) == 2
    assert {file.name for file in tmp_path.iterdir()} == {"1.JPG", "photos"}


DRONE = """
[mission]
waypoints_m = [[0, 0]]
[vehicle]
track_csv = "flown.csv"
[camera]
folder = "photos"
[[service]]
name = "detector"
program = "mine.py:Mine"
local_call_s = 1.0
[[service.settings.of_a_program]]
model = "model.onnx"
"""


@pytest.mark.parametrize("named", ["flown.csv", "mine.py", "model.onnx", "photos/1.jpg"])
@pytest.mark.parametrize(
    "command",
    [
        "fly --config d.toml --log",
        "ros --config d.toml --log",
        "simulate d.toml --log",
        "campaign d.toml --seeds 1 --out",
        "profile x --photos . --config d.toml --out",
    ],
)
def test_no_output_is_a_file_that_the_configuration_names(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("d.toml").write_text(DRONE)
    Path(named).parent.mkdir(exist_ok=True)
    Path(named).write_text("a flown track")
    assert main([*command.split(), named]) == 2
    said = capsys.readouterr().err
    assert f"names {named}, which is read" in said or f"{named} is a file of --photos" in said
    assert Path(named).read_text() == "a flown track"


def test_a_name_that_a_command_makes_itself_is_no_input_either(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "log-d1.toml"
    text = (
        '[mission]\n[[service]]\nname = "detector"\nlocal_call_s = { light = 1.0, heavy = 3.0 }\n'
        + "".join(f'[[drone]]\nname = "{name}"\nwaypoints_m = [[0, 0]]\n' for name in ("d1", "d2"))
    )
    scenario.write_text(text)
    assert main(["simulate", str(scenario), "--log", str(tmp_path / "log.toml")]) == 2
    assert "would be replaced" in capsys.readouterr().err
    assert scenario.read_text() == text
