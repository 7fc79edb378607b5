"""What a person sees of a campaign in a terminal: progress while it lasts, a summary at the end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, ProgressColumn, Task, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from upwash.eventlog.narration import counted
from upwash.lab.campaign import CombinationSummary, Cost, Fly, run_campaign
from upwash.lab.campaign_file import CampaignFile
from upwash.lab.figures import Wanted
from upwash.lab.sweep import Sweep
from upwash.support.confidence import Mean
from upwash.support.sentences import say

_LONGEST_SETTING = 14  # columns that it has in any case
_FAILURES_SHOWN = 10  # of each combination: the file has them all
_FEW_MINUTES_S, _FEW_HOURS_S = 100.0, 6_000.0  # below these a time is said in seconds, in minutes


class _Rate(ProgressColumn):
    """How many missions come in a minute."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{60 * speed:,.0f}/min" if speed else "", style="progress.data.speed")


def show_campaign(
    sweep: Sweep, out: Path | None, *, fly: Fly, workers: int | None, figures: Wanted | None = None
) -> bool:
    """Runs the campaign, prints what it came to and draws it; returns whether every run was completed.

    `workers` is how many missions fly at a time, None where that is not known.
    """
    if figures is not None:
        import upwash.lab.figures.campaign  # noqa: F401 - a missing matplotlib is reported before, not after
    out = out or Path("runs") / f"{sweep.file.stem}-{sweep.fingerprint}.csv"
    file = CampaignFile.open(out, sweep)
    console = Console()
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console) as progress:
            task = progress.add_task("missions", total=len(sweep.combinations) * sweep.seeds)
            summaries = run_campaign(
                file,
                fly=fly,
                flown=lambda runs: progress.advance(task, runs),
                costs=lambda cost: say(_planned(cost, workers), progress.console),
            )
    except KeyboardInterrupt:
        say(f"interrupted; the same command with --out {out} continues it", console)
        raise
    say(_verdict(sweep, summaries), console)
    console.print(_table(sweep, summaries))
    for summary in summaries:
        for line in _failures(sweep, summary):
            say(line, console)
    say(f"each run: {out}", console)
    if figures is not None:
        from upwash.lab.figures.campaign import draw_campaign

        draw_campaign(sweep, summaries, file.rows, figures.files("campaign"))
    return not any(summary.failures for summary in summaries)


def _planned(cost: Cost, workers: int | None) -> str:
    """How long the rest takes."""
    what = f"{counted(cost.missions, 'mission')} to fly, each {cost.mission_s:.3g} s of a processor's time"
    if workers is None:
        return f"{what}: {_duration(cost.missions * cost.mission_s)} of it in all"
    processes = "one process" if workers == 1 else f"{workers} processes"
    return f"{what}: about {_duration(cost.missions * cost.mission_s / workers)} in {processes}"


def _duration(seconds: float) -> str:
    if seconds < _FEW_MINUTES_S:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < _FEW_HOURS_S else f"{seconds / 3600:.1f} h"


def _verdict(sweep: Sweep, summaries: Sequence[CombinationSummary]) -> str:
    """Which combination is the quickest, and whether any mission failed."""
    flown = [(mean.value, each) for each in summaries if (mean := each.mission_time_s) is not None]
    if not flown:
        return "no mission was completed"
    mean_s, best = min(flown, key=lambda each: each[0])
    settings = ", ".join(f"{key}={value}" for key, value in zip(sweep.keys, best.values, strict=True))
    which = f"quickest with {settings}: " if len(summaries) > 1 else "mean mission time "
    bound_s = best.bound_s
    above = (
        f", {_above(mean_s, bound_s)} above the theoretical minimum of {bound_s / 60:.2f}" if bound_s else ""
    )
    failed = sum(len(each.failures) for each in summaries)
    failures = f"; {counted(failed, 'mission')} failed" if failed else "; no mission failed"
    return f"{which}{mean_s / 60:.2f} min{above}{failures}"


def _above(mean_s: float, bound_s: float) -> str:
    return f"{100 * (mean_s / bound_s - 1):.1f} %"


def _table(sweep: Sweep, summaries: Sequence[CombinationSummary]) -> Table:
    metered = any(summary.energy_wh for summary in summaries)
    together = any(summary.worst_s for summary in summaries)
    table = Table(box=None, padding=(0, 1), caption=_caption(together), caption_justify="left")
    for key, values in zip(sweep.keys, zip(*(each.values for each in summaries), strict=True), strict=True):
        parts = key.replace(".", ".\n")
        longest = max(map(len, (*parts.splitlines(), *values)))
        table.add_column(Text(parts), overflow="fold", min_width=min(longest, _LONGEST_SETTING))
    titles = ["completed", "failed", "mission time", "above the\nminimum"]
    titles += ["worst", "fairness"] if together else []
    for title in (*titles, *(["drawn"] if metered else [])):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for summary in summaries:
        mean = summary.mission_time_s
        completed, failed = mean.count if mean else 0, len(summary.failures)
        table.add_row(
            *(Text(value) for value in summary.values),
            str(completed),
            Text(str(failed), style="red" if failed else ""),
            _minutes(mean) if mean else "-",
            _above(mean.value, summary.bound_s) if mean and summary.bound_s else "-",
            *(_of_several(summary) if together else []),
            *([_drawn(summary.energy_wh)] if metered else []),
        )
    return table


def _caption(together: bool) -> str:
    fairness = (
        "; fairness: Jain's index of what each drone saved, 1 where all saved the same" if together else ""
    )
    return f"± 95 % confidence{fairness}"


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
