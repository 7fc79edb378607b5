"""What `upwash reproduce` prints and leaves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from upwash.lab.figures import Wanted
from upwash.lab.reproduction import quantities, sensitivity
from upwash.lab.reproduction.cells import EXPERIMENTS, SETUPS, timed_cells
from upwash.lab.reproduction.printed import contradictions
from upwash.lab.reproduction.quantities import Comparison
from upwash.lab.reproduction.sensitivity import Moved
from upwash.support.output_files import write_file

if TYPE_CHECKING:
    from rich.console import Console


class Results(msgspec.Struct, frozen=True):
    """All that one command measured."""

    comparisons: list[Comparison]
    moved: list[Moved] = []


def show_reproduction(
    *, seeds: int, vary: bool = False, figures: Wanted | None = None, results: Path | None = None
) -> None:
    """Reproduces with a progress bar and prints the comparison; with `vary` also the table of sensitivities.

    Draws the figures into a folder and writes the values of each seed into a file, where these are given.
    """
    from rich.console import Console
    from rich.progress import Progress

    if figures is not None:
        import upwash.lab.reproduction.drawing  # noqa: F401 - so that a missing matplotlib is reported before, not after

    console = Console()
    with Progress(console=Console(stderr=True), transient=True) as bar:
        total = quantities.missions(seeds) + (sensitivity.missions() if vary else 0)
        task = bar.add_task("missions", total=total)

        def progress() -> None:
            bar.advance(task)

        comparisons = quantities.reproduce(seeds=seeds, progress=progress)
        moved = sensitivity.moved(progress=progress) if vary else []
    print_comparison(comparisons, console)
    if moved:
        print_sensitivity(moved, console)
    print_notes(console)
    if results is not None:
        write_file(results, encoded(Results(comparisons, moved)))
        console.print(f"written: {results}", soft_wrap=True)
    if figures is not None:
        from upwash.lab.reproduction.drawing import draw_figures

        for file in draw_figures(figures, seeds=seeds):
            console.print(f"drawn: {file}", soft_wrap=True)


def print_comparison(comparisons: Sequence[Comparison], console: Console) -> None:
    """Prints a table per set-up, ours beside the printed figures."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    seeds = max(len(each.values) for each in comparisons)
    for setup, title in SETUPS.items():
        table = Table(
            title=f"{title}: means of {seeds} missions ± 95 %", title_justify="left", box=SIMPLE_HEAD
        )
        table.add_column("")
        for column in ("ours", "thesis", "deviation"):
            table.add_column(column, justify="right", no_wrap=True)
        for experiment in EXPERIMENTS:
            table.add_row(f"[bold]{experiment.name}")
            for each in comparisons:
                if (each.setup, each.experiment) == (setup, experiment):
                    table.add_row(f"  {each.quantity.label}", *each.written())
        console.print(table)


def print_sensitivity(moved: Sequence[Moved], console: Console) -> None:
    """Prints a table per set-up: by how much each variation changes the mission time of each cell."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    for setup, title in SETUPS.items():
        table = Table(
            title=f"{title}: change of the mission time in percent", title_justify="left", box=SIMPLE_HEAD
        )
        table.add_column("", no_wrap=True)
        for name in cell_names(setup):
            table.add_column(name, justify="right")
        for each in moved:
            table.add_row(each.label, *(f"{percent:+.1f}" for percent in each.percent[setup]))
        console.print(table)


def print_notes(console: Console) -> None:
    """Prints where the thesis's own figures disagree."""
    console.print("The thesis contradicts itself:")
    for note in contradictions():
        console.print(f"  {note}", soft_wrap=True, highlight=False)


def cell_names(setup: str) -> list[str]:
    """What the cells of Table 4.1 are called at the head of a column."""
    return [
        f"{'local' if cell.policy == 'local-only' else 'slow' if cell.experiment.slow_s2 else 'equal'} "
        f"{cell.experiment.mode}"
        for cell in timed_cells(setup)
    ]


def encoded(results: Results) -> bytes:
    """The results as JSON, to 4 digits after the point."""
    plain = msgspec.to_builtins(results)
    return msgspec.json.format(msgspec.json.encode(_rounded(plain)), indent=0) + b"\n"


def decoded(text: bytes) -> Results:
    """The results of such a file."""
    return msgspec.json.decode(text, type=Results)


def _rounded(value: object) -> object:
    match value:
        case float():
            return round(value, 4)
        case list():
            return [_rounded(each) for each in value]
        case dict():
            return {key: _rounded(each) for key, each in value.items()}
    return value
