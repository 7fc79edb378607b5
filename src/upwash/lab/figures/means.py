"""What missions took on average, as dots with their confidence, beside the theoretical minimum."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from matplotlib.axes import Axes

from upwash.lab.figures.style import PAGE_IN, SHAPES, grid, in_style, legend, new_figure, write
from upwash.report.palette import LIGHT
from upwash.support.confidence import Mean

_ROW_IN, _GROUP_IN, _REST_IN = 0.21, 0.26, 0.85
_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class DrawnMean:
    """The missions of one case in one group: how long they took, and how much less than the first case's.

    `saved_s` are the means of the differences to the missions of the group's first case that have the same seeds.
    """

    group: str
    case: str
    time_s: Mean
    saved_s: Mean | None = None
    bound_s: float | None = None


@in_style
def draw_means(rows: Sequence[DrawnMean], files: Iterable[Path]) -> None:
    """Draws the mission times, and the paired differences beside them."""
    groups = [list(group) for _, group in groupby(rows, key=lambda row: row.group)]
    height_in = _REST_IN + _GROUP_IN * len(groups) + _ROW_IN * len(rows)
    figure = new_figure(PAGE_IN, height_in)
    times, saved = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    cases = list(dict.fromkeys(row.case for row in rows))
    labels: dict[float, str] = {}
    y = 0.0
    for group in groups:
        y += _GROUP_IN / _ROW_IN
        times.annotate(
            group[0].group,
            (0, y - 0.75),
            xycoords=("axes fraction", "data"),
            xytext=(2, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold",
        )
        _draw_bound(times, group, y)
        for row in group:
            labels[y] = row.case
            _draw_mean(times, row.time_s, y, cases.index(row.case))
            if row.saved_s is not None:
                _draw_mean(saved, row.saved_s, y, cases.index(row.case))
            y += 1
    for axes in (times, saved):
        axes.set_ylim(y - 0.4, -0.1)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        grid(axes, along="x")
    times.set_yticks(list(labels), list(labels.values()))
    times.set_xlabel("mission time (min), mean and 95 % confidence")
    saved.axvline(0, color=LIGHT.soft, linewidth=0.8)
    saved.set_xlabel(f"less than {cases[0]}, paired (min)")
    legend(figure, columns=2)
    write(figure, files)


def _draw_mean(axes: Axes, mean: Mean, y: float, number: int) -> None:
    places = LIGHT.places
    axes.errorbar(
        mean.value / _MINUTE_S,
        y,
        xerr=mean.margin / _MINUTE_S if mean.count > 1 else None,
        marker=("o", *SHAPES)[number % (1 + len(SHAPES))],
        color=places[number % len(places)],
        markersize=4.5,
        elinewidth=1.2,
        capsize=2.0,
        zorder=3,
    )


def _draw_bound(axes: Axes, group: Sequence[DrawnMean], y: float) -> None:
    bound_s = group[0].bound_s
    if bound_s is None:
        return
    is_named = "theoretical minimum" in axes.get_legend_handles_labels()[1]
    axes.plot(
        [bound_s / _MINUTE_S] * 2,
        [y - 0.45, y + len(group) - 0.55],
        color=LIGHT.ink,
        linewidth=1.0,
        linestyle=(0, (2, 1.5)),
        label=None if is_named else "theoretical minimum",
    )


@in_style
def draw_sweep(
    values: Sequence[float], rows: Sequence[DrawnMean], files: Iterable[Path], *, key: str
) -> None:
    """Draws the mission times over one numeric setting: mean, 95 % confidence, and the theoretical minimum."""
    figure = new_figure(PAGE_IN / 2, 2.6)
    axes = figure.subplots()
    order = sorted(range(len(values)), key=lambda index: values[index])
    x = [values[index] for index in order]
    means = [rows[index].time_s for index in order]
    minutes = [mean.value / _MINUTE_S for mean in means]
    axes.plot(x, minutes, color=LIGHT.places[2], marker="o", markersize=3.5, label="mean")
    if all(mean.count > 1 for mean in means):
        axes.fill_between(
            x,
            [(mean.value - mean.margin) / _MINUTE_S for mean in means],
            [(mean.value + mean.margin) / _MINUTE_S for mean in means],
            color=LIGHT.places[2],
            alpha=0.2,
            linewidth=0,
            label="95 % confidence",
        )
    bounds = [rows[index].bound_s for index in order]
    if all(bound_s is not None for bound_s in bounds):
        axes.plot(
            x,
            [(bound_s or 0.0) / _MINUTE_S for bound_s in bounds],
            color=LIGHT.ink,
            linewidth=1.0,
            linestyle=(0, (2, 1.5)),
            label="theoretical minimum",
        )
    axes.set_xlabel(key)
    axes.set_ylabel("mission time (min)")
    grid(axes, along="y")
    legend(figure, columns=2)
    write(figure, files)
