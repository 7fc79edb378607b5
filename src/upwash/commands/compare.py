"""upwash compare: flies every policy in the same worlds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import count
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    compare = commands.add_parser("compare", help="fly every policy in the same worlds, beside the bound")
    compare.add_argument("scenarios", type=Path, nargs="*", metavar="SCENARIO", help="TOML files")
    compare.add_argument(
        "--thesis", action="store_true", help="the eight cells of the thesis's experiments too"
    )
    compare.add_argument(
        "--seeds", type=count, default=30, metavar="N", help="missions per world and policy (default: 30)"
    )
    compare.add_argument("--workers", type=count, metavar="N", help="processes (default: one per core)")
    compare.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies them all and prints the table."""
    from upwash.lab.comparison import show_comparison

    if not options.scenarios and not options.thesis:
        raise UsageError("nothing to compare in: name scenario files, or give --thesis")
    show_comparison(options.scenarios, thesis=options.thesis, seeds=options.seeds, workers=options.workers)
    return True
