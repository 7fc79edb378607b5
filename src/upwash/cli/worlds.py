"""upwash worlds: writes worlds drawn at random, as scenarios."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from upwash.cli.arguments import fills, option, seeds
from upwash.lab.scenario import as_toml
from upwash.lab.worlds import draw_world
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.text import counted

ARGUMENTS = {
    "--seeds N|A..B": option("draw the worlds of the seeds 1 to N, or A to B", type=seeds, required=True),
    "--surveys": "draw surveys, whose photos overlap",
    "--out DIR": fills(
        "where the scenarios go, as world-SEED.toml or survey-SEED.toml (default: worlds)",
        default=Path("worlds"),
    ),
}


def run(options: argparse.Namespace) -> None:
    """Draw them and write a file for each."""
    kind, given = ("survey", " --surveys") if options.surveys else ("world", "")
    with work("worlds drawn", len(options.seeds)) as done:
        for seed in options.seeds:
            head = f"# {kind.capitalize()} {seed}, drawn by: upwash worlds --seeds {seed}..{seed}{given}\n"
            text = as_toml(draw_world(seed, survey=options.surveys))
            write_file(options.out / f"{kind}-{seed}.toml", (head + text).encode())
            done()
    say(f"{counted(len(options.seeds), 'world')} in {options.out}", Console(markup=False))
