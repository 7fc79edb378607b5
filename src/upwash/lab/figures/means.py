"""What missions took on average, as dots with their confidence, beside the theoretical minimum."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, groupby
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from upwash.lab.figures.style import (
    DASHES,
    PAGE_IN,
    SHAPES,
    few_ticks,
    grid,
    in_style,
    legend,
    new_figure,
    wrapped,
    write,
)
from upwash.report.palette import LIGHT
from upwash.support.confidence import Mean

_LINE_IN, _GAP_IN, _AXIS_IN = 0.135, 0.085, 0.6
_LONGEST_LABEL, _LONGEST_FIRST = 36, 22  # characters of a line
_TICKS = 6
_MINUTE_S = 60.0
_BOUND: Mapping[str, Any] = {
    "color": LIGHT.ink,
    "linewidth": 1.0,
    "linestyle": (0, (2, 1.5)),
    "label": "theoretical minimum",
}


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
    """Draws the mission times, each with its bound, and the paired differences beside them where there are any."""
    cases = list(dict.fromkeys(row.case for row in rows))
    names: list[str] = []
    drawn: list[DrawnMean | None] = []  # None beside the name of a group
    for group, own in groupby(rows, key=lambda row: row.group):
        members = list(own)
        names += [wrapped(name, _LONGEST_LABEL) for name in (group, *(row.case for row in members))]
        drawn += [None, *members]
    heights_in = [_GAP_IN + _LINE_IN * (1 + name.count("\n")) for name in names]
    ends_in = list(accumulate(heights_in))
    middles_in = [end_in - height_in / 2 for end_in, height_in in zip(ends_in, heights_in, strict=True)]
    paired = any(row.saved_s for row in rows)
    figure = new_figure(PAGE_IN, _AXIS_IN + ends_in[-1])
    times, *beside = figure.subplots(
        1, 2 if paired else 1, sharey=True, squeeze=False, width_ratios=(3, 2)[: 1 + paired]
    )[0]
    bounds: list[tuple[float, float, float]] = []  # minutes, and from where to where
    for row, y_in, height_in in zip(drawn, middles_in, heights_in, strict=True):
        if row is None:
            continue
        look = _look(cases.index(row.case), alone=len(rows) == len(cases))
        _draw_mean(times, row.time_s, y_in, look)
        if row.saved_s is not None:
            _draw_mean(beside[0], row.saved_s, y_in, look)
        if row.bound_s is not None:
            bounds.append((row.bound_s / _MINUTE_S, y_in - height_in / 2, y_in + height_in / 2))
    if bounds:
        times.vlines(*zip(*bounds, strict=True), **_BOUND)
    for axes in (times, *beside):
        axes.set_ylim(ends_in[-1] + _GAP_IN, 0)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        few_ticks(axes.xaxis, most=_TICKS)
        grid(axes, along="x")
    times.set_yticks(middles_in, names)
    for label, row in zip(times.get_yticklabels(), drawn, strict=True):
        label.set_fontweight("bold" if row is None else "normal")
    times.set_xlabel("mission time (min), mean and\n95 % confidence")
    for axes in beside:
        axes.axvline(0, color=LIGHT.soft, linewidth=0.8)
        first = cases[0] if len(cases[0]) <= _LONGEST_FIRST else "the first row"
        axes.set_xlabel(f"less than {first},\npaired (min)")
    legend(figure)
    write(figure, files)


def _look(case: int, *, alone: bool) -> Mapping[str, Any]:
    """How a case looks in each group; the first one, which the others are compared with, is hollow."""
    face = LIGHT.paper if case == 0 else LIGHT.ink
    marks = ("o", *SHAPES)
    return {"marker": "o" if alone else marks[case % len(marks)], "color": LIGHT.ink, "markerfacecolor": face}


def _draw_mean(axes: Axes, mean: Mean, y_in: float, look: Mapping[str, Any]) -> None:
    axes.errorbar(
        mean.value / _MINUTE_S,
        y_in,
        xerr=mean.margin / _MINUTE_S if mean.count > 1 else None,
        **look,
        markersize=4.5,
        elinewidth=1.2,
        zorder=3,
    )


@in_style
def draw_sweep(
    values: Sequence[float], rows: Sequence[DrawnMean], files: Iterable[Path], *, key: str
) -> None:
    """Draws the mission times over one numeric setting: mean, 95 % confidence, and the theoretical minimum."""
    figure = new_figure(PAGE_IN / 2, 2.2)
    axes = figure.subplots()
    order = sorted(range(len(values)), key=lambda index: values[index])
    x = [values[index] for index in order]
    means = [rows[index].time_s for index in order]
    bounds = [rows[index].bound_s for index in order]
    minutes = [mean.value / _MINUTE_S for mean in means]
    margins = [mean.margin / _MINUTE_S if mean.count > 1 else math.nan for mean in means]
    known = any(mean.count > 1 for mean in means)
    axes.errorbar(
        x,
        minutes,
        yerr=margins if known else None,
        color=LIGHT.ink,
        marker="o",
        markersize=3.5,
        elinewidth=1.0,
        label="mean and 95 % confidence" if known else "mean",
    )
    if any(bound_s is not None for bound_s in bounds):
        least = [math.nan if bound_s is None else bound_s / _MINUTE_S for bound_s in bounds]
        axes.plot(x, least, **_BOUND, marker=".", markersize=3.0)
    few_ticks(axes.xaxis, most=_TICKS, whole=all(value == round(value) for value in x))
    axes.set_xlabel(wrapped(key, _LONGEST_LABEL))
    axes.set_ylabel("mission time (min)")
    grid(axes, along="y")
    legend(figure)
    write(figure, files)


@in_style
def draw_savings(shares: Mapping[str, Sequence[float]], files: Iterable[Path], *, first: str) -> None:
    """Draws what share of the first policy's time each policy saves in each world, ascending: losses, then gains."""
    figure = new_figure(PAGE_IN / 2, 2.6)
    axes = figure.subplots()
    for number, (policy, saved) in enumerate(shares.items()):
        places = [100 * (place + 0.5) / len(saved) for place in range(len(saved))]
        axes.plot(
            places,
            [100 * share for share in saved],
            color=LIGHT.ink,
            linestyle=("-", *DASHES)[number % (1 + len(DASHES))],
            marker=SHAPES[number % len(SHAPES)],
            markevery=0.2,
            markersize=3.5,
            label=policy,
        )
    axes.axhline(0, color=LIGHT.soft, linewidth=0.8)
    axes.set_xlabel("worlds (%), by what is saved there")
    axes.set_ylabel(wrapped(f"less time than {first} (%)", _LONGEST_LABEL))
    grid(axes, along="y")
    legend(figure)
    write(figure, files)
