"""The figure of a campaign: over one numeric setting as a line, over anything else as a dot for each combination."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from upwash.lab.campaign import CombinationSummary
from upwash.lab.campaign_file import Row as FlownRow
from upwash.lab.figures.means import Row, draw_means, draw_sweep
from upwash.lab.sweep import Sweep
from upwash.support.confidence import Mean, mean_of


def draw_campaign(
    sweep: Sweep, summaries: Sequence[CombinationSummary], flown: Sequence[FlownRow], files: Iterable[Path]
) -> None:
    """Draws the mission times of every combination that has a completed mission; nothing where none has."""
    first = summaries[0].values
    shown: list[tuple[tuple[str, ...], Row]] = []
    for summary in summaries:
        if summary.mission_time_s is not None:
            case = ", ".join(f"{key}={value}" for key, value in zip(sweep.keys, summary.values, strict=True))
            saved_s = None if summary.values == first else _saved_s(flown, first, summary.values)
            row = Row(sweep.file.stem, case, summary.mission_time_s, saved_s, summary.bound_s)
            shown.append((summary.values, row))
    if not shown:
        return
    rows = [row for _, row in shown]
    numbers = [_number(values[0]) for values, _ in shown] if len(sweep.keys) == 1 else []
    known = [number for number in numbers if number is not None]
    if len(known) == len(rows) > 1:
        draw_sweep(known, rows, files, key=sweep.keys[0])
    else:
        draw_means(rows, files)


def _saved_s(flown: Sequence[FlownRow], first: tuple[str, ...], values: tuple[str, ...]) -> Mean | None:
    """By how much missions with these values are shorter than the first combination's with the same seeds."""
    before_s, after_s = (
        {
            row.seed: row.mission_time_s
            for row in flown
            if row.values == wanted and row.completed and row.mission_time_s is not None
        }
        for wanted in (first, values)
    )
    saved_s = [before_s[seed] - time_s for seed, time_s in after_s.items() if seed in before_s]
    return mean_of(saved_s) if saved_s else None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
