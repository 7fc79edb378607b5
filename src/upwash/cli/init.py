"""upwash init: makes a folder with a mission, a service, configurations, keys and a test."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from upwash.cli.arguments import announce, fills
from upwash.errors import UsageError
from upwash.real.trust.authority import make_keys
from upwash.support.output_files import write_file

_TEMPLATES = Path(__file__).with_name("project")
_NAMES = {"gitignore": ".gitignore"}  # Git would obey the template under its own name


ARGUMENTS = {"folder": fills("a new or empty folder")}


def run(options: argparse.Namespace) -> None:
    """Write the files, print their names and what to do next."""
    folder: Path = options.folder
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is not an empty folder: name another, or empty it first")
    for template in sorted(path for path in _TEMPLATES.iterdir() if path.is_file()):
        file = folder / _NAMES.get(template.name, template.name)
        write_file(file, template.read_bytes())
        announce(str(file))
    for file in make_keys(folder / "keys", servers=[["s1"]], drones=["drone"], operators=["operator"]):
        announce(str(file))
    announce(
        f"next: cd {shlex.quote(str(folder))} && upwash simulate drone.toml    (README.md has the other commands)"
    )
