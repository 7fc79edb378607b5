"""What `upwash reproduce` prints, writes and draws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.lab.figures import FigureFiles
from upwash.lab.reproduction import quantities, sensitivity
from upwash.lab.reproduction.cells import (
    EXPERIMENTS,
    SETUPS,
    ThesisCell,
    fly,
    local_only,
    parameters,
    timed_cells,
)
from upwash.lab.reproduction.quantities import Comparison, contradictions, printed_figures
from upwash.lab.reproduction.sensitivity import Moved
from upwash.lab.run import Run
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted


class Results(msgspec.Struct, frozen=True):
    """The results of a `reproduce` command."""

    comparisons: list[Comparison]
    moved: list[Moved] = []


def show_reproduction(
    *, seeds: int, vary: bool = False, figures: FigureFiles | None = None, results: Path | None = None
) -> None:
    """Reproduces with a progress bar and prints the comparison; with `vary` also the table of sensitivities.

    `figures` and `results`, if given, are where the figures and the values of each seed are written.
    """
    if figures is not None:
        import upwash.lab.figures.style  # noqa: F401 - a missing matplotlib is reported before, not after

    console = Console()
    with work("missions", quantities.missions(seeds) + (sensitivity.missions() if vary else 0)) as flown:
        comparisons = quantities.reproduce(seeds=seeds, progress=flown)
        moved = sensitivity.moved(progress=flown) if vary else []
    print_comparison(comparisons, console)
    if moved:
        print_sensitivity(moved, console)
    console.print("The thesis contradicts itself:")
    for note in contradictions():
        say(Text(note), console, indent=2)
    if results is not None:
        write_file(results, encoded(Results(comparisons, moved)))
        console.print(f"written: {results}", soft_wrap=True)
    if figures is not None:
        for file in draw_figures(figures, seeds=seeds):
            console.print(f"drawn: {file}", soft_wrap=True)


def print_comparison(comparisons: Sequence[Comparison], console: Console) -> None:
    """Prints a table per set-up, ours beside the printed figures."""
    seeds = max(len(comparison.values) for comparison in comparisons)
    for setup, title in SETUPS.items():
        table = Table(
            title=f"{title}: means of {counted(seeds, 'mission')} ± 95 %",
            title_justify="left",
            box=SIMPLE_HEAD,
        )
        table.add_column("")
        for column in ("ours", "thesis", "deviation"):
            table.add_column(column, justify="right", no_wrap=True)
        for experiment in EXPERIMENTS:
            table.add_row(Text(experiment.name, style="bold"))
            for comparison in comparisons:
                if (comparison.setup, comparison.experiment) == (setup, experiment):
                    table.add_row(f"  {comparison.quantity.label}", *comparison.written())
        show_table(table, console)


def print_sensitivity(moved: Sequence[Moved], console: Console) -> None:
    """Prints a table per set-up: by how much each variation changes the mission time of each cell."""
    for setup, title in SETUPS.items():
        table = Table(
            title=f"{title}: change of the mission time in percent", title_justify="left", box=SIMPLE_HEAD
        )
        table.add_column("", no_wrap=True)
        for name in cell_names(setup):
            table.add_column(name, justify="right")
        for variation in moved:
            table.add_row(variation.label, *(f"{percent:+.1f}" for percent in variation.percent[setup]))
        show_table(table, console)


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
    """The results from their JSON."""
    return msgspec.json.decode(text, type=Results)


def _rounded(value: object) -> object:
    match value:
        case float():
            return round(value, 4)
        case list():
            return [_rounded(item) for item in value]
        case dict():
            return {key: _rounded(item) for key, item in value.items()}
    return value


_SEEDS = range(1, 31)


def draw_figures(figures: FigureFiles, *, seeds: int) -> list[Path]:
    """Draws the figures, with the spread over the seeds; returns the files.

    If the thesis says how many waits of a figure were in vain, the mission is that of the first seed with as many.
    """
    from upwash.lab.figures.calls import draw_call_delays
    from upwash.lab.figures.coverage import draw_coverage

    drawn = figures.files("figure_4.4")
    draw_coverage(
        parameters("hitl"), drawn, title="Figure 4.4: waypoints, server coverage and way of the flight"
    )
    shown = [(setup, experiment) for setup in SETUPS for experiment in EXPERIMENTS]
    for number, (setup, experiment) in enumerate(shown, start=5):
        files = figures.files(f"figure_4.{number}")
        cell = ThesisCell(setup, experiment, "location-aware")
        seed, run = _shown(cell)
        speed = "s2 is slower than s1" if experiment.slow_s2 else "s2 is equally fast to s1"
        place = "HITL/SITL" if setup == "hitl" else "simulation"
        mode = f"call delay in the {experiment.mode} processing mode"
        draw_call_delays(
            run.events,
            reference=fly(local_only(setup, experiment), seed).events,
            files=files,
            title=f"Figure 4.{number}: {mode}, {speed} ({place}; seed {seed})",
            others=[fly(cell, seed).events for seed in _SEEDS[:seeds]] if seeds > 1 else (),
        )
        drawn += files
    return drawn


def _shown(cell: ThesisCell) -> tuple[int, Run]:
    first = fly(cell, _SEEDS[0])
    printed = printed_figures()
    in_vain, waits = (
        printed.get((cell.experiment.name, cell.setup, name)) for name in ("waits_in_vain", "waits_decided")
    )
    if in_vain is None:
        return _SEEDS[0], first
    for seed in _SEEDS:
        run = first if seed == _SEEDS[0] else fly(cell, seed)
        totals = run.result.totals
        if totals.waits_failed == in_vain and waits in (None, totals.waits):
            return seed, run
    return _SEEDS[0], first
