"""What a person sees of a campaign: progress while it lasts, then a summary and a figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, ProgressColumn, Task, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from upwash.lab.campaigns.campaign import CombinationSummary, Cost, Fly, run_campaign
from upwash.lab.campaigns.file import CampaignFile, CampaignRow
from upwash.lab.campaigns.sweep import ParameterSweep
from upwash.lab.figures import FigureFiles
from upwash.support.confidence import Mean, mean_saving
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, duration, lasting

_NO_MARGIN = 1e-6  # seconds or watt-hours: a mean of equal numbers is rounded
_FAILURES_SHOWN = 10  # of each combination: the file has them all


class _Rate(ProgressColumn):
    """Missions per minute."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{60 * speed:,.0f}/min" if speed else "", style="progress.data.speed")


def show_campaign(
    sweep: ParameterSweep,
    out: Path | None,
    *,
    fly: Fly,
    workers: int | None,
    figures: FigureFiles | None = None,
) -> bool:
    """Runs the campaign, prints and draws its results; returns whether every run was completed.

    `workers` is how many missions fly at a time, None if that is not known.
    """
    if figures is not None:
        import upwash.lab.figures.means  # noqa: F401 - a missing matplotlib is reported before, not after
    out = out or Path("runs") / f"{sweep.file.stem}-{sweep.fingerprint}.csv"
    file = CampaignFile.open(out, sweep)
    console = Console()
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    try:
        total = len(sweep.combinations) * sweep.seeds
        with Progress(*columns, console=console) as progress, work("missions", total) as done:
            task = progress.add_task("missions", total=total)

            def flown(runs: int) -> None:
                progress.advance(task, runs)
                done(runs)

            summaries = run_campaign(
                file,
                fly=fly,
                flown=flown,
                costs=lambda cost: say(_planned(cost, workers), progress.console),
            )
    except KeyboardInterrupt:
        say(f"interrupted; the same command with --out {out} continues it", console)
        raise
    say(_verdict(sweep, summaries), console)
    show_table(_table(sweep, summaries), console)
    if _all_are_alike(summaries):
        say(Text("without [noise] all seeds are alike: one mission says it all"), console)
    for summary in summaries:
        for line in _failures(sweep, summary):
            say(line, console)
    say(f"each run: {out}", console)
    if figures is not None:
        draw_campaign(sweep, summaries, file.rows, figures.files("campaign"))
    return not any(summary.failures for summary in summaries)


def _planned(cost: Cost, workers: int | None) -> str:
    what = f"{counted(cost.missions, 'mission')} to fly, each {cost.mission_s:.3g} s of a processor's time"
    if workers is None:
        return f"{what}: {duration(cost.missions * cost.mission_s)} of it in all"
    processes = "one process" if workers == 1 else f"{workers} processes"
    return f"{what}: about {duration(cost.missions * cost.mission_s / workers)} in {processes}"


def _quickest(summaries: Sequence[CombinationSummary]) -> tuple[float, CombinationSummary] | None:
    flown = ((mean.value, summary) for summary in summaries if (mean := summary.mission_time_s) is not None)
    return min(flown, key=lambda pair: pair[0], default=None)


def _winners(summaries: Sequence[CombinationSummary]) -> list[CombinationSummary]:
    """The combinations with the least mean time as printed; none where all have it."""
    if (quickest := _quickest(summaries)) is None:
        return []
    least = lasting(quickest[0])
    alike = [s for s in summaries if s.mission_time_s and lasting(s.mission_time_s.value) == least]
    return alike if len(alike) < len(summaries) else []


def _verdict(sweep: ParameterSweep, summaries: Sequence[CombinationSummary]) -> str:
    quickest = _quickest(summaries)
    if quickest is None:
        return "no mission was completed"
    mean_s, best = quickest
    which = (
        f"quickest with {', '.join(_settings(sweep, best))}: " if len(summaries) > 1 else "mean mission time "
    )
    bound_s = best.bound_s
    above = (
        f", {_above(mean_s, bound_s)} above the theoretical minimum of {lasting(bound_s)}" if bound_s else ""
    )
    failed = sum(len(summary.failures) for summary in summaries)
    failures = f"; {counted(failed, 'mission')} failed" if failed else "; no mission failed"
    return f"{which}{lasting(mean_s)}{above}{failures}"


def _settings(sweep: ParameterSweep, summary: CombinationSummary) -> list[str]:
    return [f"{key}={value}" for key, value in zip(sweep.keys, summary.values, strict=True)]


def _above(mean_s: float, bound_s: float) -> str:
    return f"{100 * (mean_s / bound_s - 1):.1f} %"


def _table(sweep: ParameterSweep, summaries: Sequence[CombinationSummary]) -> Table:
    metered = any(summary.energy_wh for summary in summaries)
    together = any(summary.worst_s for summary in summaries)
    winners = _winners(summaries)
    notes = ["* quickest"] if winners else []
    notes += [] if _all_are_alike(summaries) else ["± 95 % confidence"]
    notes += (
        ["fairness: Jain's index of what each drone saved, 1 where all saved the same"] if together else []
    )
    table = Table(box=None, padding=(0, 1), caption="; ".join(notes), caption_justify="left")
    if winners:
        table.add_column("", no_wrap=True)  # the mark of the quickest
    for key in sweep.keys:
        table.add_column(Text(key.replace(".", ".\n")), overflow="fold")
    titles = ["completed", "failed", "mission time", "above the\nminimum"]
    titles += ["worst\ntime", "fairness"] if together else []
    for title in (*titles, *(["drawn"] if metered else [])):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for summary in summaries:
        mean = summary.mission_time_s
        completed, failed = mean.count if mean else 0, len(summary.failures)
        table.add_row(
            *(["*" if summary in winners else ""] if winners else []),
            *(Text(value) for value in summary.values),
            str(completed),
            Text(str(failed), style="red" if failed else ""),
            lasting(mean.value, mean.margin) if mean else "-",
            _above(mean.value, summary.bound_s) if mean and summary.bound_s else "-",
            *(_of_several(summary) if together else []),
            *([_drawn(summary.energy_wh)] if metered else []),
            style="bold green" if summary in winners else None,
        )
    return table


def _are_alike(mean: Mean) -> bool:
    return mean.count > 1 and mean.margin < _NO_MARGIN


def _all_are_alike(summaries: Sequence[CombinationSummary]) -> bool:
    times = [summary.mission_time_s for summary in summaries if summary.mission_time_s]
    return bool(times) and all(map(_are_alike, times))


def _margin(mean: Mean, margin: float) -> str:
    return "" if mean.count == 1 or _are_alike(mean) else f" ± {margin:.2f}"


def _of_several(summary: CombinationSummary) -> list[str]:
    if summary.worst_s is None or summary.jain is None:
        return ["-", "-"]
    return [lasting(summary.worst_s.value), f"{summary.jain.value:.3f}"]


def _drawn(mean: Mean | None) -> str:
    if mean is None:
        return "-"
    return f"{mean.value:.2f}{_margin(mean, mean.margin)} Wh"


def _failures(sweep: ParameterSweep, summary: CombinationSummary) -> list[Text]:
    settings = "".join(f"{setting} " for setting in _settings(sweep, summary))
    failures = list(summary.failures.items())
    lines = [Text(f"{settings}seed {seed}: {why}", style="red") for seed, why in failures[:_FAILURES_SHOWN]]
    if len(failures) > _FAILURES_SHOWN:
        lines.append(Text(f"{settings}and {len(failures) - _FAILURES_SHOWN} more failed", style="red"))
    return lines


def draw_campaign(
    sweep: ParameterSweep,
    summaries: Sequence[CombinationSummary],
    rows: Sequence[CampaignRow],
    files: Iterable[Path],
) -> None:
    """Draws the mission times of every combination that has a completed mission; nothing where none has.

    Over one numeric setting they are a line, over other settings a dot for each combination, named by what varies.
    """
    from upwash.lab.figures.means import DrawnMean, draw_means, draw_sweep

    flown = [summary for summary in summaries if summary.mission_time_s is not None]
    if not flown:
        return
    first_s = _times_s(rows, summaries[0])
    several = len(summaries) > 1
    common = [
        setting
        for setting in _settings(sweep, summaries[0])
        if several and all(setting in _settings(sweep, summary) for summary in summaries)
    ]
    drawn = [
        DrawnMean(
            ", ".join([sweep.file.stem, *common]),
            ", ".join(setting for setting in _settings(sweep, summary) if setting not in common) or "all",
            summary.mission_time_s,
            None if summary is summaries[0] else mean_saving(first_s, _times_s(rows, summary)),
            summary.bound_s,
        )
        for summary in flown
        if summary.mission_time_s is not None
    ]
    try:
        numbers = [float(summary.values[0]) for summary in flown] if len(sweep.keys) == 1 else []
    except ValueError:
        numbers = []
    if len(numbers) > 1 and all(map(math.isfinite, numbers)):
        draw_sweep(numbers, drawn, files, key=sweep.keys[0])
    else:
        draw_means(drawn, files)


def _times_s(rows: Sequence[CampaignRow], summary: CombinationSummary) -> dict[int, float]:
    return {
        row.seed: row.mission_time_s
        for row in rows
        if row.values == summary.values and row.completed and row.mission_time_s is not None
    }
