"""upwash reproduce: flies the thesis's experiments."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import add_figures, add_seeds, figures_of

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    reproduce = commands.add_parser("reproduce", help="fly the thesis's experiments, beside what it printed")
    add_seeds(reproduce, "fly each cell", default=30)
    add_figures(reproduce, "the figures 4.4 to 4.12")
    reproduce.add_argument(
        "--sensitivity", action="store_true", help="say how far each parameter moves the mission times, too"
    )
    reproduce.add_argument(
        "--json", type=Path, metavar="FILE", help="write the figures of each mission there"
    )
    reproduce.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies them on virtual time and prints the table."""
    from upwash.lab.reproduction.output import show_reproduction

    show_reproduction(
        seeds=options.seeds,
        vary=options.sensitivity,
        figures=figures_of(options),
        results=options.json,
    )
    return True
