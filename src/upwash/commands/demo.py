"""upwash demo: flies the demonstration."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import add_live, add_policy, new_run_folder

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands

_MOST_RUNTIME_BYTES = 100_000


def add(commands: Commands) -> None:
    """Adds the command."""
    demo = commands.add_parser("demo", help="fly the demonstration: a survey over two edge servers, all here")
    demo.add_argument("--folder", type=Path, help="where everything of the run goes (default: runs/TIME)")
    demo.add_argument(
        "--runtime", type=Path, metavar="FILE", help="a table [runtime] for both daemons, such as containers"
    )
    add_policy(demo, instead_of="the demonstration's")
    add_live(demo)
    demo.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies it."""
    os.environ.setdefault("GRPC_VERBOSITY", "ERROR")
    from upwash.loading import extra

    with extra("detector"):
        from upwash.demo import fly_demonstration
    runtime = _read(options.runtime) if options.runtime else ""
    fly_demonstration(
        options.folder or new_run_folder(), runtime=runtime, policy=options.policy, live_port=options.live
    )
    return True


def _read(file: Path) -> str:
    from upwash.errors import UsageError
    from upwash.user_files import read_file

    try:
        return read_file(file, most_bytes=_MOST_RUNTIME_BYTES).decode()
    except (OSError, ValueError) as error:
        raise UsageError(f"--runtime {file} cannot be read: {error}") from None
