"""A command that a message shows does what it says once it is pasted."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from upwash.cli.main import command_line
from upwash.real.network.networkmanager import Device, DeviceKind, NetworkConnection, NetworkState
from upwash.real.network.profiles import interface_trouble, modified
from upwash.support.text import command

SOURCE = Path(__file__).parents[2] / "src" / "upwash"
FILLED_IN = "1"  # for what a message fills in: fits a name, a file and a number
SHOWN = re.compile(r"`(upwash [^`]*)`|: (upwash [a-z]+ [^`\n]*)$")
NAME = 'field\'s Wired "connection" $1'


def shown_commands(file: Path) -> Iterator[list[str]]:
    """The words of each command of upwash's own that messages of the file show."""
    source = file.read_text()
    if not re.search(r'"upwash"|upwash [a-z]', source):
        return
    tree = ast.parse(source)
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "command":
            words = [text_of(argument) or FILLED_IN for argument in node.args]
            if words[0] == "upwash":
                yield words
        elif isinstance(node, ast.JoinedStr) or (text_of(node) and id(node) not in parts | docstrings):
            for quoted, last in SHOWN.findall(written(node)):
                yield shlex.split(quoted or last)


def text_of(node: ast.AST) -> str:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def written(node: ast.AST) -> str:
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(text_of(part) if isinstance(part, ast.Constant) else FILLED_IN for part in parts)


def test_each_command_of_a_message_is_understood() -> None:
    shown = [(file, words) for file in sorted(SOURCE.rglob("*.py")) for words in shown_commands(file)]
    for file, words in shown:
        try:
            options = command_line().parse_args(words[1:])
        except SystemExit:
            pytest.fail(f"a message of {file} shows {shlex.join(words)}")
        if words[1] == "keys":
            assert options.folder or options.signing, f"{shlex.join(words)} does not say where keys go"
    assert len({file for file, _ in shown}) >= 10


def test_a_shell_takes_a_shown_command_as_it_is_meant() -> None:
    shown = command("nmcli", "connection", "down", NAME)
    assert shlex.split(shown.strip("`")) == ["nmcli", "connection", "down", NAME]


def test_the_way_to_free_an_interface_names_whatever_is_active_there() -> None:
    device = Device("/d", "wlan1", DeviceKind.WIFI, 100, True, "/a")
    active = NetworkConnection("/a", "u", NAME, "802-11-wireless", ("/d",), ())
    trouble = interface_trouble("wlan1", ["s1-net"], NetworkState([device], [active], []))
    assert [shlex.split(shown) for shown in re.findall(r"`(.*?)`", trouble)] == [
        ["nmcli", "connection", "modify", NAME, "connection.autoconnect", "no"],
        ["nmcli", "connection", "down", NAME],
    ]


def test_a_setting_of_no_value_is_an_empty_word() -> None:
    shown = modified(NAME, "connection.interface-name ''").strip("`")
    assert shlex.split(shown) == ["nmcli", "connection", "modify", NAME, "connection.interface-name", ""]
