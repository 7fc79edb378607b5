"""upwash reproduce: flies the thesis's experiments."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import figures_of, figures_with, seeds_of, writes
from upwash.lab.reproduction.output import show_reproduction

ARGUMENTS = {
    **seeds_of("fly each cell", default=30),
    **figures_with("the figures 4.4 to 4.12"),
    "--sensitivity": "also print the effect of each parameter on mission times",
    "--json FILE": writes("write the figures of each mission there"),
}


def run(options: argparse.Namespace) -> None:
    """Fly them on virtual time and print the table."""
    figures = figures_of(options)
    show_reproduction(seeds=options.seeds, vary=options.sensitivity, figures=figures, results=options.json)
