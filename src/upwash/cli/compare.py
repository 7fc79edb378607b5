"""upwash compare: flies every policy in the same scenarios, or holds flights against each other by their logs."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from upwash.cli.arguments import figures_of, figures_with, option, reads, repeated, seeds, seeds_of
from upwash.errors import UsageError
from upwash.lab.campaigns.comparison import ComparedPolicy, compare
from upwash.lab.campaigns.sweep import read_overrides
from upwash.lab.figures import FigureFiles
from upwash.report.groups import differences, in_words, verdict
from upwash.report.record import read_records
from upwash.report.reviews import logs_among
from upwash.report.tables import total_rows
from upwash.support.confidence import Mean, mean_of
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import lasting

_LOG = ".jsonl"
Cell = Callable[[ComparedPolicy], str]


ARGUMENTS = {
    "scenarios SCENARIO": reads("TOML files; or event logs of flights, to compare these", nargs="*"),
    "--thesis": "the eight cells of the thesis's experiments too",
    "--worlds N|A..B": option(
        "the drawn worlds of the seeds 1 to N, or A to B, too: each is flown once", type=seeds
    ),
    "--surveys N|A..B": option("the drawn surveys of these seeds too, with photos that overlap", type=seeds),
    "--policy NAME": repeated(
        "fly only these policies, and compare them with the first; your own as mine.py:Class (default: all built in)",
        "policies",
    ),
    **seeds_of("fly each policy", default=30),
    "--set KEY=VALUE": repeated(
        "fly the files with that value of a key, such as policy.stay_or_go=go", "settings"
    ),
    "--markdown": "print tables in Markdown, the default into a file or another program",
    "--workers N": "processes (default: one per core)",
    **figures_with("the mission times with their confidence, and the paired differences,"),
}


def run(options: argparse.Namespace) -> None:
    """Fly them all with a progress bar, and print the results; in Markdown where no person reads them."""
    if any(map(_is_log, options.scenarios)):
        _compare_flights(options)
        return
    if not any((options.scenarios, options.thesis, options.worlds, options.surveys)):
        raise UsageError("nothing to compare in: name scenario files, or give --thesis or --worlds 1..100")
    overrides = read_overrides(options.settings)
    figures = figures_of(options)
    with work("missions") as progress:
        rows = compare(
            options.scenarios,
            policies=options.policies or None,
            overrides=overrides,
            seeds=options.seeds,
            worlds=options.worlds,
            surveys=options.surveys,
            workers=options.workers,
            thesis=options.thesis,
            progress=lambda done, total: progress(total=total),
        )
    console = Console(markup=False, highlight=False)
    if _is_for_programs(options, console):
        console.print("\n".join(in_markdown(rows)), soft_wrap=True)
    else:
        print_tables(rows, console)
    if figures is not None:
        _draw(rows, figures)


def _compare_flights(options: argparse.Namespace) -> None:
    """Print the results of the logs' flights, a column each, and their differences."""
    others = (
        options.thesis,
        options.worlds,
        options.surveys,
        options.policies,
        options.settings,
        options.figures,
    )
    if any(others) or not all(map(_is_log, options.scenarios)):
        raise UsageError("logs are compared as they are: name logs alone, without options that fly missions")
    records = read_records(logs_among(options.scenarios))
    names = [record.name for record in records]
    rows = list(total_rows([record.result for record in records]))
    console = Console(markup=False, highlight=False)
    say(verdict(records), console)
    if _is_for_programs(options, console):
        lines = (*_heading("", *names), *(_line(name, *values) for name, values in rows))
        console.print("", *lines, "", sep="\n", soft_wrap=True)
    else:
        table = Table("", *(Column(Text(name), overflow="fold") for name in names), box=None, padding=(0, 1))
        for name, values in rows:
            table.add_row(name, *map(Text, values))
        show_table(table, console)
    for difference in differences(records):
        say(in_words(difference), console)


def _is_log(file: Path) -> bool:
    """Whether the file is an event log: it is named as one, or begins as no TOML begins."""
    if file.suffix == _LOG or not file.is_file():
        return file.suffix == _LOG
    with file.open("rb") as opened:
        return opened.read(1) == b"{"


def _is_for_programs(options: argparse.Namespace, console: Console) -> bool:
    return options.markdown or not console.is_terminal


def _draw(rows: Sequence[ComparedPolicy], figures: FigureFiles) -> None:
    from upwash.lab.figures.means import DrawnMean, draw_means, draw_savings  # these need matplotlib

    drawn = []
    for row in rows:
        if row.completed:
            time = Mean(row.completed, row.mean_s, row.half_width_s)
            saved = (
                Mean(row.completed, row.saved_s, row.saved_half_width_s or 0.0)
                if row.saved_s is not None
                else None
            )
            bound_s = None if math.isnan(row.bound_s) else row.bound_s
            drawn.append(DrawnMean(row.scenario, row.policy, time, saved, bound_s))
    draw_means(drawn, figures.files("compare"))
    for family in "worlds", "surveys":
        own = [row for row in rows if row.saved_shares and row.scenario.startswith(f"{family} ")]
        if own:
            shares = {row.policy: row.saved_shares for row in own}
            draw_savings(shares, figures.files(family), first=rows[0].policy)


def print_tables(rows: Sequence[ComparedPolicy], console: Console) -> None:
    """Prints, for each scenario, which policy is the quickest, and a table with a row for each."""
    for scenario, group in itertools.groupby(rows, key=lambda row: row.scenario):
        own = list(group)
        winners = _winners(own)
        say(f"{scenario}: {_verdict(own)}", console)
        table = Table(box=None, padding=(0, 1))
        columns = {
            "": lambda row: row.policy,
            "mission\ntime": _interval,
            "above the\nminimum": _above_bound,
            "completed": _completed if any(row.completed < row.missions for row in own) else None,
            "worst,\nfairness": _fleet_cell if any(row.worst_s is not None for row in own) else None,
            "turned back,\nhidden": _going_cell if any(row.hidden_s is not None for row in own) else None,
            "Wh": _energy_cell if any(row.energy_wh is not None for row in own) else None,
        }
        if any(row.saved_shares for row in own):
            columns |= {f"{title},\n{more}": cell for (title, more), cell in _BESIDE_FIRST.items()}
        shown = {title: cell for title, cell in columns.items() if cell is not None}
        table.add_column("", no_wrap=True)  # the mark of the quickest
        for title in shown:
            table.add_column(Text(title), justify="right" if title else "left", no_wrap=True)
        for row in own:
            wins = row in winners
            cells = (cell(row) for cell in shown.values())
            table.add_row("*" if wins else "", *cells, style="bold green" if wins else None)
            for part in _by_kind(row):
                beside = _BESIDE_FIRST.values()
                table.add_row(
                    "",
                    f"  {part.policy}",
                    *(cell(part) if cell in beside else "" for cell in [*shown.values()][1:]),
                )
        show_table(table, console)
        console.print()


def _by_kind(row: ComparedPolicy) -> Iterator[ComparedPolicy]:
    """The policy's drawn worlds of each kind apart; none where all are of one kind."""
    if len(row.saved_by_kind) > 1:
        for kind, shares in row.saved_by_kind.items():
            yield dataclasses.replace(row, policy=f"{kind} ({len(shares)})", saved_shares=shares)


def _quickest(rows: Sequence[ComparedPolicy]) -> ComparedPolicy | None:
    return min((row for row in rows if row.completed), key=lambda row: row.mean_s, default=None)


def _winners(rows: Sequence[ComparedPolicy]) -> list[ComparedPolicy]:
    """The policies with the least time as printed; none where all have it."""
    if (best := _quickest(rows)) is None:
        return []
    alike = [row for row in rows if row.completed and lasting(row.mean_s) == lasting(best.mean_s)]
    return alike if len(alike) < len(rows) else []


def _verdict(rows: Sequence[ComparedPolicy]) -> str:
    flown, best = [row for row in rows if row.completed], _quickest(rows)
    if best is None:
        return "no policy completed a mission"
    others = sum(
        row is not best and row.mean_s - best.mean_s <= row.half_width_s + best.half_width_s for row in flown
    )
    verb = "is" if others == 1 else "are"
    alike = f"; {others} more {verb} as quick within the margin of error" if others else ""
    return (
        f"{best.policy} is quickest: {lasting(best.mean_s)}"
        + (
            ""
            if math.isnan(best.bound_s)
            else f", {_above_bound(best)} above the theoretical minimum of {lasting(best.bound_s)}"
        )
        + alike
    )


def _interval(row: ComparedPolicy) -> str:
    if not row.completed:
        return "-"
    return lasting(row.mean_s, row.half_width_s if row.completed > 1 else None)


def _above_bound(row: ComparedPolicy) -> str:
    if not row.completed or math.isnan(row.bound_s):
        return "-"
    return f"{100 * (row.mean_s / row.bound_s - 1):.1f} %"


def _completed(row: ComparedPolicy) -> str:
    return f"{row.completed} of {row.missions}"


def in_markdown(rows: Sequence[ComparedPolicy]) -> Iterator[str]:
    """Tables with a row for each scenario: minutes, and what is known of fleets, late answers and energy."""
    policies = list(dict.fromkeys(row.policy for row in rows))
    yield from _heading("mission time", "bound", *policies)
    for scenario, group in itertools.groupby(rows, key=lambda row: row.scenario):
        own = list(group)
        winners = _winners(own)
        cells = (f"**{_cell(row)}**" if row in winners else _cell(row) for row in own)
        yield _line(scenario, "-" if math.isnan(own[0].bound_s) else lasting(own[0].bound_s), *cells)
    beside = [row for row in rows if row.saved_shares]
    if beside:
        yield ""
        yield from _heading(f"in each world, beside {rows[0].policy}", *map(" ".join, _BESIDE_FIRST))
        several = len({row.scenario for row in beside}) > 1
        for row in beside:
            name = f"{row.policy}, {row.scenario}" if several else row.policy
            yield _line(name, *_beside_first(row))
            for part in _by_kind(row):
                yield _line(f"{name}, {part.policy}", *_beside_first(part))
    further: tuple[tuple[str, Callable[[ComparedPolicy], float | None], Cell], ...] = (
        ("worst time, fairness (Jain's index)", lambda row: row.worst_s, _fleet_cell),
        ("turned back, hidden time", lambda row: row.hidden_s, _going_cell),
        ("Wh", lambda row: row.energy_wh, _energy_cell),
    )
    for title, value, cell in further:
        known = [row for row in rows if value(row) is not None]
        if known:
            yield ""
            yield from _heading(title, *policies)
            for scenario, group in itertools.groupby(known, key=lambda row: row.scenario):
                yield _line(scenario, *map(cell, group))


def _beside_first(row: ComparedPolicy) -> Iterator[str]:
    return (cell(row) for cell in _BESIDE_FIRST.values())


def _heading(*titles: str) -> tuple[str, str]:
    return _line(*titles), f"|{'---|' * len(titles)}"


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(row: ComparedPolicy) -> str:
    if not row.completed:
        return f"{_completed(row)} completed"
    ended = "" if row.completed == row.missions else f", {_completed(row)} completed"
    above = "" if math.isnan(row.bound_s) else f" ({100 * (row.mean_s / row.bound_s - 1):+.1f} %)"
    return f"{_interval(row)}{above}{ended}"


def _fleet_cell(row: ComparedPolicy) -> str:
    if row.worst_s is None or row.jain is None:
        return "-"
    return f"{lasting(row.worst_s)}, {row.jain:.3f}"


def _going_cell(row: ComparedPolicy) -> str:
    return "-" if row.turned_back is None else f"{row.turned_back:.1f}, {lasting(row.hidden_s or 0.0)}"


def _energy_cell(row: ComparedPolicy) -> str:
    if not row.completed or row.energy_wh is None:
        return "-"
    margin = f" ± {row.energy_half_width_wh:.2f}" if row.completed > 1 else ""
    return f"{row.energy_wh:.2f}{margin}"


def _saved_cell(row: ComparedPolicy) -> str:
    if not row.saved_shares:
        return "-"
    saved = mean_of(row.saved_shares)
    return _percent(saved.value) + (f" ± {100 * saved.margin:.1f}" if saved.count > 1 else "")


def _percent(share: float) -> str:
    return f"{100 * share + 0.0:.1f} %"


_EVEN = 0.01  # smaller differences count as none
_BESIDE_FIRST: dict[tuple[str, str], Cell] = {
    ("mean time", "saved"): _saved_cell,
    ("quicker", "by 1 % or more"): lambda row: f"{sum(share >= _EVEN for share in row.saved_shares)}",
    ("slower", "by 1 % or more"): lambda row: f"{sum(share <= -_EVEN for share in row.saved_shares)}",
    ("most", "saved"): lambda row: _percent(max(0.0, *row.saved_shares)) if row.saved_shares else "-",
    ("most", "lost"): lambda row: (
        _percent(max(0.0, *(-share for share in row.saved_shares))) if row.saved_shares else "-"
    ),
}
