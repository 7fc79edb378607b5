"""upwash compare: flies every policy in the same scenarios."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import count
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands
    from upwash.lab.comparison import ComparedPolicy


def add(commands: Commands) -> None:
    """Adds the command."""
    compare = commands.add_parser("compare", help="fly every policy in the same scenarios, beside the bound")
    compare.add_argument("scenarios", type=Path, nargs="*", metavar="SCENARIO", help="TOML files")
    compare.add_argument(
        "--thesis", action="store_true", help="the eight cells of the thesis's experiments too"
    )
    compare.add_argument(
        "--seeds", type=count, default=30, metavar="N", help="missions per scenario and policy (default: 30)"
    )
    compare.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=VALUE",
        help="fly the files with that value of a key, such as policy.stay_or_go=go",
    )  # fmt: skip
    compare.add_argument("--workers", type=count, metavar="N", help="processes (default: one per core)")
    compare.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies them all with a progress bar, and prints Markdown tables: minutes, and Wh where they are metered."""
    from rich.console import Console
    from rich.progress import Progress

    from upwash import compare
    from upwash.lab.sweep import read_overrides

    if not options.scenarios and not options.thesis:
        raise UsageError("nothing to compare in: name scenario files, or give --thesis")
    overrides = read_overrides(options.settings)
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
    Console(markup=False).print("\n".join(_lines(rows)), soft_wrap=True, highlight=False)
    return True


def _lines(rows: Sequence[ComparedPolicy]) -> Iterator[str]:
    policies = list(dict.fromkeys(row.policy for row in rows))
    yield f"| minutes | bound | {' | '.join(policies)} |"
    yield f"|---|---|{'---|' * len(policies)}"
    for scenario, own in itertools.groupby(rows, key=lambda row: row.scenario):
        first, *others = own
        cells = " | ".join(_cell(row) for row in (first, *others))
        yield f"| {scenario} | {_minutes(first.bound_s)} | {cells} |"
    if fleets := [row for row in rows if row.worst_s is not None]:
        yield ""
        yield f"| worst minutes, Jain's index | {' | '.join(policies)} |"
        yield f"|---|{'---|' * len(policies)}"
        for scenario, own in itertools.groupby(fleets, key=lambda row: row.scenario):
            yield f"| {scenario} | {' | '.join(_fleet_cell(row) for row in own)} |"
    if going := [row for row in rows if row.hidden_s is not None]:
        yield ""
        yield f"| turned back, hidden minutes | {' | '.join(policies)} |"
        yield f"|---|{'---|' * len(policies)}"
        for scenario, own in itertools.groupby(going, key=lambda row: row.scenario):
            yield f"| {scenario} | {' | '.join(map(_going_cell, own))} |"
    if metered := [row for row in rows if row.energy_wh is not None]:
        yield ""
        yield f"| Wh | {' | '.join(policies)} |"
        yield f"|---|{'---|' * len(policies)}"
        for scenario, own in itertools.groupby(metered, key=lambda row: row.scenario):
            yield f"| {scenario} | {' | '.join(_energy_cell(row) for row in own)} |"


def _cell(row: ComparedPolicy) -> str:
    if not row.completed:
        return f"0 of {row.missions} completed"
    margin = f" ± {row.half_width_s / 60:.2f}" if row.completed > 1 else ""
    ended = "" if row.completed == row.missions else f", {row.completed} of {row.missions} completed"
    return f"{_minutes(row.mean_s)}{margin} ({100 * (row.mean_s / row.bound_s - 1):+.1f} %){ended}"


def _fleet_cell(row: ComparedPolicy) -> str:
    if row.worst_s is None or row.jain is None:
        return "-"
    return f"{_minutes(row.worst_s)}, {row.jain:.3f}"


def _going_cell(row: ComparedPolicy) -> str:
    return "-" if row.turned_back is None else f"{row.turned_back:.1f}, {_minutes(row.hidden_s or 0.0)}"


def _energy_cell(row: ComparedPolicy) -> str:
    if not row.completed:
        return "-"
    margin = f" ± {row.energy_half_width_wh:.2f}" if row.completed > 1 else ""
    return f"{row.energy_wh:.2f}{margin}"


def _minutes(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{seconds / 60:.2f}"
