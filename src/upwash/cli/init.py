"""upwash init: makes a folder with a mission, a service, configurations, keys and a test."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import announce

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands

_NAMES = {"gitignore": ".gitignore"}  # whose own name would have an effect where the templates lie


def add(commands: Commands) -> None:
    """Adds the command."""
    init = commands.add_parser(
        "init", help="make a folder with a mission, a service, configurations, keys and a test"
    )
    init.add_argument("folder", type=Path, help="a new or empty folder")
    init.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Writes the files, prints their names, and says what to do next."""
    from upwash.errors import UsageError
    from upwash.real.trust.authority import make_keys
    from upwash.support.output_files import write_file

    folder: Path = options.folder
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is not an empty folder: name another, or empty it first")
    templates = Path(__file__).with_name("project")
    for template in sorted(each for each in templates.iterdir() if each.is_file()):
        file = folder / _NAMES.get(template.name, template.name)
        write_file(file, template.read_bytes())
        announce(str(file))
    for file in make_keys(folder / "keys", servers=[["s1"]], drones=["drone"], operators=["operator"]):
        announce(str(file))
    announce(
        f"next: cd {shlex.quote(str(folder))} && upwash simulate drone.toml    (README.md has the other commands)"
    )
    return True
