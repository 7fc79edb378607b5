"""upwash reproduce: flies the thesis's experiments."""

from __future__ import annotations

import argparse
from pathlib import Path

from upwash.cli.arguments import add_figures, add_seeds, figures_of
from upwash.lab.reproduction.output import show_reproduction


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_seeds(parser, "fly each cell", default=30)
    add_figures(parser, "the figures 4.4 to 4.12")
    parser.add_argument(
        "--sensitivity", action="store_true", help="also print the effect of each parameter on mission times"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures of each mission there")


def run(options: argparse.Namespace) -> bool:
    """Fly them on virtual time and print the table."""
    figures = figures_of(options)
    show_reproduction(seeds=options.seeds, vary=options.sensitivity, figures=figures, results=options.json)
    return True
