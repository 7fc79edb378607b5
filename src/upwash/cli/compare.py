"""upwash compare: flies every policy in the same scenarios."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import add_figures, add_seeds, count, figures_of
from upwash.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from upwash.cli.arguments import Commands
    from upwash.lab.campaigns.comparison import ComparedPolicy
    from upwash.lab.figures import FigureFiles


def add(commands: Commands) -> None:
    """Adds the command."""
    compare = commands.add_parser("compare", help="fly every policy in the same scenarios, beside the bound")
    compare.add_argument("scenarios", type=Path, nargs="*", metavar="SCENARIO", help="TOML files")
    compare.add_argument(
        "--thesis", action="store_true", help="the eight cells of the thesis's experiments too"
    )
    add_seeds(compare, "fly each policy", default=30)
    compare.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=VALUE",
        help="fly the files with that value of a key, such as policy.stay_or_go=go",
    )  # fmt: skip
    compare.add_argument(
        "--markdown", action="store_true", help="tables in Markdown, as into a file or another program"
    )
    compare.add_argument("--workers", type=count, metavar="N", help="processes (default: one per core)")
    add_figures(compare, "the mission times with their confidence, and the paired differences,")
    compare.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies them all with a progress bar, and prints what they came to: as Markdown where no person reads it."""
    from rich.console import Console
    from rich.progress import Progress

    from upwash import compare
    from upwash.cli.compared import in_markdown, print_tables
    from upwash.lab.campaigns.sweep import read_overrides

    if not options.scenarios and not options.thesis:
        raise UsageError("nothing to compare in: name scenario files, or give --thesis")
    overrides = read_overrides(options.settings)
    figures = figures_of(options)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("missions", total=None)
        rows = compare(
            options.scenarios,
            overrides=overrides,
            seeds=options.seeds,
            workers=options.workers,
            thesis=options.thesis,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    console = Console(markup=False, highlight=False)
    if options.markdown or not console.is_terminal:
        console.print("\n".join(in_markdown(rows)), soft_wrap=True)
    else:
        print_tables(rows, console)
    if figures is not None:
        _draw(rows, figures)
    return True


def _draw(rows: Sequence[ComparedPolicy], figures: FigureFiles) -> None:
    from upwash.lab.figures.means import DrawnMean, draw_means
    from upwash.support.confidence import Mean

    draw_means(
        [
            DrawnMean(
                row.scenario,
                row.policy,
                Mean(row.completed, row.mean_s, row.half_width_s),
                Mean(row.completed, row.saved_s, row.saved_half_width_s or 0.0)
                if row.saved_s is not None
                else None,
                row.bound_s,
            )
            for row in rows
            if row.completed
        ],
        figures.files("compare"),
    )
