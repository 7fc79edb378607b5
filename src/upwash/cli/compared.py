"""What policies came to in the same scenarios: as tables for a person, or in Markdown."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from upwash.lab.campaigns.comparison import ComparedPolicy

if TYPE_CHECKING:
    from rich.console import Console

Cell = Callable[[ComparedPolicy], str]


def print_tables(rows: Sequence[ComparedPolicy], console: Console) -> None:
    """Prints, for each scenario, which policy is the quickest, and a table with a row for each."""
    from rich.table import Table
    from rich.text import Text

    from upwash.support.sentences import say

    for scenario, group in itertools.groupby(rows, key=lambda row: row.scenario):
        own = list(group)
        say(f"{scenario}: {_verdict(own)}", console)
        table = Table(box=None, padding=(0, 1))
        columns = {
            "": lambda row: row.policy,
            "minutes": _interval,
            "above the\nminimum": _above_bound,
            "completed": _completed if any(row.completed < row.missions for row in own) else None,
            "worst,\nfairness": _fleet_cell if any(row.worst_s is not None for row in own) else None,
            "turned back,\nmin hidden": _going_cell if any(row.hidden_s is not None for row in own) else None,
            "Wh": _energy_cell if any(row.energy_wh is not None for row in own) else None,
        }
        shown = {title: cell for title, cell in columns.items() if cell is not None}
        for title in shown:
            table.add_column(Text(title), justify="right" if title else "left", no_wrap=bool(title))
        for row in own:
            table.add_row(*(cell(row) for cell in shown.values()))
        console.print(table)
        console.print()


def _verdict(rows: Sequence[ComparedPolicy]) -> str:
    flown = [row for row in rows if row.completed]
    if not flown:
        return "no policy completed a mission"
    best = min(flown, key=lambda row: row.mean_s)
    others = sum(row is not best and _is_alike(row, best) for row in flown)
    alike = (
        f"; {others} more {'is' if others == 1 else 'are'} as quick within the margin of error"
        if others
        else ""
    )
    return (
        f"{best.policy} is quickest: {_minutes(best.mean_s)} min, {_above_bound(best)} above the theoretical minimum "
        f"of {_minutes(best.bound_s)}{alike}"
    )


def _is_alike(row: ComparedPolicy, best: ComparedPolicy) -> bool:
    return row.mean_s - best.mean_s <= row.half_width_s + best.half_width_s


def _interval(row: ComparedPolicy) -> str:
    margin = f" ± {row.half_width_s / 60:.2f}" if row.completed > 1 else ""
    return f"{_minutes(row.mean_s)}{margin}" if row.completed else "-"


def _above_bound(row: ComparedPolicy) -> str:
    return f"{100 * (row.mean_s / row.bound_s - 1):.1f} %" if row.completed else "-"


def _completed(row: ComparedPolicy) -> str:
    return f"{row.completed} of {row.missions}"


def in_markdown(rows: Sequence[ComparedPolicy]) -> Iterator[str]:
    """Tables with a row for each scenario: minutes, and what else is known of fleets, late answers and energy."""
    policies = list(dict.fromkeys(row.policy for row in rows))
    yield f"| minutes | bound | {' | '.join(policies)} |"
    yield f"|---|---|{'---|' * len(policies)}"
    for scenario, group in itertools.groupby(rows, key=lambda row: row.scenario):
        own = list(group)
        yield f"| {scenario} | {_minutes(own[0].bound_s)} | {' | '.join(map(_cell, own))} |"
    further: tuple[tuple[str, Callable[[ComparedPolicy], float | None], Cell], ...] = (
        ("worst minutes, fairness (Jain's index)", lambda row: row.worst_s, _fleet_cell),
        ("turned back, hidden minutes", lambda row: row.hidden_s, _going_cell),
        ("Wh", lambda row: row.energy_wh, _energy_cell),
    )
    for title, value, cell in further:
        known = [row for row in rows if value(row) is not None]
        if known:
            yield ""
            yield f"| {title} | {' | '.join(policies)} |"
            yield f"|---|{'---|' * len(policies)}"
            for scenario, each in itertools.groupby(known, key=lambda row: row.scenario):
                yield f"| {scenario} | {' | '.join(map(cell, each))} |"


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
    if not row.completed or row.energy_wh is None:
        return "-"
    margin = f" ± {row.energy_half_width_wh:.2f}" if row.completed > 1 else ""
    return f"{row.energy_wh:.2f}{margin}"


def _minutes(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{seconds / 60:.2f}"
