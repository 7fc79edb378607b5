"""What a person sees of a campaign in a terminal: progress while it lasts, a summary at the end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from upwash.lab.campaign import CombinationSummary, Fly, run_campaign
from upwash.lab.campaign_file import CampaignFile
from upwash.lab.sweep import Sweep
from upwash.support.confidence import Mean

_FAILURES_SHOWN = 10  # of each combination: the file has them all


def show_campaign(sweep: Sweep, out: Path | None, *, fly: Fly) -> bool:
    """Runs the campaign and prints what it came to; returns whether every run was completed."""
    out = out or Path("runs") / f"{sweep.file.stem}-{sweep.fingerprint}.csv"
    file = CampaignFile.open(out, sweep)
    console = Console()
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console) as progress:
            task = progress.add_task("missions", total=len(sweep.combinations) * sweep.seeds)
            summaries = run_campaign(file, fly=fly, flown=lambda runs: progress.advance(task, runs))
    except KeyboardInterrupt:
        console.print(f"interrupted; the same command with --out {out} continues it", soft_wrap=True)
        raise
    console.print(_table(sweep, summaries))
    for summary in summaries:
        for line in _failures(sweep, summary):
            console.print(line, soft_wrap=True)
    console.print(f"each run: {out}", soft_wrap=True)
    return not any(summary.failures for summary in summaries)


def _table(sweep: Sweep, summaries: Sequence[CombinationSummary]) -> Table:
    metered = any(summary.energy_wh for summary in summaries)
    together = any(summary.worst_s for summary in summaries)
    apart = 1 if together else 2  # so that a line holds it
    table = Table(box=None, padding=(0, apart), caption="± 95 % confidence", caption_justify="left")
    for key in sweep.keys:
        table.add_column(key, overflow="fold")
    titles = ["completed", "failed", "mission time", "over bound"]
    titles += ["worst", "Jain"] if together else []
    for title in (*titles, *(["drawn"] if metered else [])):
        table.add_column(title, justify="right", no_wrap=True)
    for summary in summaries:
        mean = summary.mission_time_s
        completed, failed = mean.count if mean else 0, len(summary.failures)
        table.add_row(
            *(Text(value) for value in summary.values),
            str(completed),
            Text(str(failed), style="red" if failed else ""),
            _minutes(mean) if mean else "-",
            f"{100 * (mean.value / summary.bound_s - 1):.1f} %" if mean and summary.bound_s else "-",
            *(_of_several(summary) if together else []),
            *([_drawn(summary.energy_wh)] if metered else []),
        )
    return table


def _minutes(mean: Mean) -> str:
    margin = f" ± {mean.margin / 60:.2f}" if mean.count > 1 else ""
    return f"{mean.value / 60:.2f}{margin} min"


def _of_several(summary: CombinationSummary) -> list[str]:
    if summary.worst_s is None or summary.jain is None:
        return ["-", "-"]
    return [f"{summary.worst_s.value / 60:.2f} min", f"{summary.jain.value:.3f}"]


def _drawn(mean: Mean | None) -> str:
    if mean is None:
        return "-"
    margin = f" ± {mean.margin:.2f}" if mean.count > 1 else ""
    return f"{mean.value:.2f}{margin} Wh"


def _failures(sweep: Sweep, summary: CombinationSummary) -> list[Text]:
    settings = "".join(f"{key}={value} " for key, value in zip(sweep.keys, summary.values, strict=True))
    failures = list(summary.failures.items())
    lines = [Text(f"{settings}seed {seed}: {why}", style="red") for seed, why in failures[:_FAILURES_SHOWN]]
    if len(failures) > _FAILURES_SHOWN:
        lines.append(Text(f"{settings}and {len(failures) - _FAILURES_SHOWN} more failed", style="red"))
    return lines
