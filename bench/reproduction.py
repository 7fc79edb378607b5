"""What is kept of a reproduction of the thesis, and the tables that docs/reproduction.md has of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from upwash.lab.reproduction.cells import EXPERIMENTS, SETUPS
from upwash.lab.reproduction.output import Results, cell_names
from upwash.lab.reproduction.quantities import LOCAL_ONLY, OFFLOADING, Comparison, contradictions
from upwash.lab.reproduction.sensitivity import Moved

FIRST = 3  # seeds whose figures are kept one by one, for a test to fly them again
_TIMES = (LOCAL_ONLY.name, OFFLOADING.name)
_LEAST_PERCENT = 1.5  # what moves every mission time by less is not shown


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of one experiment: its mean over all missions, and its values of the first seeds."""

    setup: str
    experiment: str
    quantity: str
    label: str
    missions: int
    ours: str
    thesis: str
    deviation: str
    first: list[float]


class Kept(msgspec.Struct, frozen=True):
    """A reproduction in short."""

    rows: list[Row]
    moved: list[Moved]


def shortened(results: Results) -> Kept:
    """What is kept of it."""
    return Kept(
        [_row(comparison) for comparison in results.comparisons], [_rounded(each) for each in results.moved]
    )


def _row(comparison: Comparison) -> Row:
    ours, thesis, deviation = comparison.written()
    return Row(
        setup=comparison.setup,
        experiment=comparison.experiment.name,
        quantity=comparison.quantity.name,
        label=comparison.quantity.label,
        missions=len(comparison.values),
        ours=ours,
        thesis=thesis,
        deviation=deviation,
        first=[round(value, 4) for value in comparison.values[:FIRST]],
    )


def _rounded(moved: Moved) -> Moved:
    return Moved(
        moved.label,
        {setup: [round(each, 2) for each in percent] for setup, percent in moved.percent.items()},
    )


def times(figures: Kept) -> str:
    """Table 4.1's mission times."""
    missions = max(row.missions for row in figures.rows)
    return f"Means of {missions} missions ± 95 % confidence.\n\n" + _side_by_side(
        figures, [name for name in _names(figures) if name in _TIMES]
    )


def others(figures: Kept) -> str:
    """Every other figure that the thesis prints."""
    return _side_by_side(figures, [name for name in _names(figures) if name not in _TIMES])


def sensitivity(figures: Kept) -> str:
    """By how many percent variations move mission times, a table per set-up; without those that move none."""
    tables = []
    moved = [each for each in figures.moved if _most_percent(each) >= _LEAST_PERCENT]
    for setup, title in SETUPS.items():
        head = (f"{title}, percent", *cell_names(setup))
        rows = (
            (each.label.strip(), *(f"{percent:+.1f}" for percent in each.percent[setup])) for each in moved
        )
        tables.append(_table(head, rows))
    return "\n\n".join(tables)


def _most_percent(moved: Moved) -> float:
    return max(abs(percent) for by_cell in moved.percent.values() for percent in by_cell)


def disagreements() -> str:
    """Where the thesis's own figures disagree."""
    return "\n".join(f"- {contradiction}" for contradiction in contradictions())


def _names(figures: Kept) -> list[str]:
    return list(dict.fromkeys(row.quantity for row in figures.rows))


def _side_by_side(figures: Kept, names: Sequence[str]) -> str:
    found = {(row.setup, row.experiment, row.quantity): row for row in figures.rows}

    def lines() -> Iterator[Sequence[str]]:
        for experiment in EXPERIMENTS:
            for name in names:
                rows = [found.get((setup, experiment.name, name)) for setup in SETUPS]
                label = next((row.label.strip() for row in rows if row), None)
                if label is not None and any(row.thesis for row in rows if row):
                    cells = ((row.ours, row.thesis, row.deviation) if row else ("", "", "") for row in rows)
                    yield f"{experiment.name}: {label}", *(cell for three in cells for cell in three)

    return _table(("", "HITL", "thesis", "", "simulation", "thesis", ""), lines())


def _table(head: Sequence[str], rows: Iterator[Sequence[str]]) -> str:
    first, *rest = (f"| {' | '.join(line)} |" for line in (head, *rows))
    return "\n".join((first, "|---" * len(head) + "|", *rest))
