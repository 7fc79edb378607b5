"""Writes docs/commands.md from the command line's own help: `python site/commands.py`."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

from upwash.cli.exit_codes import MEANINGS
from upwash.cli.main import command_line

PAGE = Path(__file__).parents[1] / "docs" / "commands.md"

_HEAD = """\
# Commands

<!-- written by site/commands.py from the commands' own help: change that, then run `make docs` -->

`upwash COMMAND --help` prints the same. The [exit codes](flight-ends.md#how-a-command-ends):

CODES

Every command has `-h` (`--help`) and `-v` (`--verbose`: also print where in the code an error arose).

Work of more than two seconds reports on standard error what is done and how much is left: on a terminal in one
line, which changes, elsewhere in a line each 10 s.
"""
_EVERYWHERE = {"help", "verbose"}


def page() -> str:
    """The page as it should be."""
    found = commands()
    listed = (f"| [`{name}`](#upwash-{name}) | {_said(help_)} |" for name, (help_, _) in found.items())
    sections = (_section(name, help_, each) for name, (help_, each) in found.items())
    head = _HEAD.replace("CODES", "\n".join(_codes()))
    return "\n".join((head, "| command | |", "|---|---|", *listed, "", *sections))


def _codes() -> Iterator[str]:
    yield from ("| exit code | |", "|---|---|")
    yield from (f"| {code:d} | {meaning} |" for code, meaning in MEANINGS.items())


def commands() -> dict[str, tuple[str, argparse.ArgumentParser]]:
    """Each command's help and parser, by name, in the order of `upwash --help`."""
    (found,) = (
        action for action in command_line()._actions if isinstance(action, argparse._SubParsersAction)
    )
    helps = {action.dest: action.help or "" for action in found._choices_actions}
    return {name: (helps[name], each) for name, each in found.choices.items()}


def _section(name: str, help_: str, command: argparse.ArgumentParser) -> str:
    rows = [*_rows(command)]
    table = ["", "| argument | |", "|---|---|", *rows] if rows else []
    return "\n".join((f"## `upwash {name}`", "", f"{_sentence(_said(help_))}", *table, ""))


def _rows(command: argparse.ArgumentParser) -> Iterator[str]:
    for action in command._actions:
        if action.dest not in _EVERYWHERE:
            yield f"| {_written(action)} | {_needed(action)}{_said(action.help or '')} |"


def _written(action: argparse.Action) -> str:
    if not action.option_strings:
        return f"`{action.metavar or action.dest.upper()}`"
    value = _value(action)
    return ", ".join(f"`{string}{f' {value}' if value else ''}`" for string in action.option_strings)


def _value(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    name = action.metavar or (action.choices and "|".join(map(str, action.choices))) or action.dest.upper()
    shown = (" ".join(name) if isinstance(name, tuple) else str(name)).replace("|", "\\|")
    return f"[{shown}]" if action.nargs == "?" else f"{shown}…" if action.nargs in ("+", "*") else shown


def _needed(action: argparse.Action) -> str:
    return "needed; " if action.option_strings and action.required else ""


def _said(text: str) -> str:
    return re.sub(r"\s+", " ", text.replace("%%", "%")).replace("|", "\\|")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
