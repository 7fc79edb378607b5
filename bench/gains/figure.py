"""The kept missions as one picture: a row for each world, a mark for each variant, with its confidence."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.gains.kept import Kept
from bench.gains.shares import MeasuredWorld, measured_worlds
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from upwash.lab.figures.style import in_style
from upwash.report.palette import LIGHT

_MARKS = tuple(zip(LIGHT.places[1:], "s^DvpPXh", strict=True))
_BREAK, _LEAST, _MOST = 80.0, -4.0, 101.5  # percent: where the scale changes, and where it begins and ends
_COARSER = 6.0  # times, below the break
_TICKS = (0, 20, 40, 60, 80, 85, 90, 95, 100)
_ROW_IN, _HEAD_IN = 0.36, 1.3
_RIGHT = 1.085  # of the axes' width: where the column beside them ends
_SPREAD = 0.62  # of a row's height, over which its marks are spread so that none hides another
_INK, _PALE = LIGHT.ink, LIGHT.band


class Row(NamedTuple):
    """Where a world is drawn; rows count downwards, with room before each group."""

    world: MeasuredWorld
    y: float


@in_style
def draw(kept: Kept, file: Path) -> None:
    """Draws the share of the possible gain as a PNG file."""
    rows = list(_rows(measured_worlds(kept.missions)))
    figure = Figure(figsize=(9.0, _HEAD_IN + _ROW_IN * (rows[-1].y + 1)), dpi=130, layout="constrained")
    axes = figure.subplots()
    for number, row in enumerate(rows):
        if number % 2:
            axes.axhspan(row.y - 0.5, row.y + 0.5, color=_PALE, linewidth=0)
        _draw_row(axes, row, kept.variants[1:])
    _scale(axes)
    axes.set_yticks([row.y for row in rows], [row.world.name for row in rows])
    axes.set_ylim(rows[-1].y + 0.6, -1.1)
    axes.tick_params(length=0)
    axes.set_frame_on(False)
    _beside(axes, rows)
    figure.supxlabel(
        "share of the possible gain: 0 % is local-only, 100 % the theoretical minimum; bars are 95 % confidence\n"
        f"(below {_BREAK:.0f} % the scale is {_COARSER:.0f} times coarser)",
        fontsize=9,
        color=_INK,
    )
    figure.legend(handles=_legend(kept.variants[1:]), loc="outside upper center", ncols=6, frameon=False)
    figure.savefig(file, format="png")


def _scale(axes: Axes) -> None:
    def on_paper(share: ArrayLike) -> ArrayLike:
        above = np.asarray(share) - _BREAK
        return np.where(above < 0, above / _COARSER, above)

    def from_paper(place: ArrayLike) -> ArrayLike:
        above = np.asarray(place)
        return np.where(above < 0, above * _COARSER, above) + _BREAK

    axes.set_xscale("function", functions=(on_paper, from_paper))
    axes.set_xlim(_LEAST, _MOST)
    axes.set_xticks(_TICKS, [f"{share} %" for share in _TICKS])
    axes.grid(axis="x", color=LIGHT.line, linewidth=0.6)
    axes.set_axisbelow(True)
    for share, style in ((0, "-"), (_BREAK, ":"), (100, "-")):
        axes.axvline(share, color=_INK, linewidth=0.9, linestyle=style)


def _rows(worlds: Sequence[MeasuredWorld]) -> list[Row]:
    rows: list[Row] = []
    y = 0.0
    for _, group in groupby(worlds, lambda world: world.group):
        for world in group:
            rows.append(Row(world, y))
            y += 1.0
        y += 0.9
    return rows


def _draw_row(axes: Axes, row: Row, variants: Sequence[str]) -> None:
    """Variants one below the other, in the ladder's order; a variant without effect has no mark."""
    for number, variant in enumerate(variants):
        if variant not in row.world.times_s or not row.world.changes(variant):
            continue
        share = row.world.share(variant)
        colour, shape = _MARKS[number % len(_MARKS)]
        axes.errorbar(
            100 * share.value,
            row.y + _SPREAD * (number / max(1, len(variants) - 1) - 0.5),
            xerr=100 * share.margin,
            color=colour,
            marker=shape,
            markersize=4.5,
            markeredgewidth=0,
            elinewidth=1.2,
            capsize=0,
        )


def _beside(axes: Axes, rows: Sequence[Row]) -> None:
    """The groups' names to the left; to the right the gain of all mechanisms together."""

    def note(text: str, x: float, y: float, *, weight: str = "normal") -> None:
        axes.annotate(
            text,
            (x, y),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="center",
            fontweight=weight,
            annotation_clip=False,
        )

    for name, group in groupby(rows, lambda row: row.world.group):
        y = next(group).y - 0.75
        note(name, -0.01, y, weight="bold")
        note("all", _RIGHT, y, weight="bold")
    for row in rows:
        note(f"{100 * row.world.share(row.world.steps[-1]).value:.1f} %", _RIGHT, row.y)


def _legend(variants: Sequence[str]) -> list[Line2D]:
    return [
        Line2D(
            [],
            [],
            color=colour,
            marker=shape,
            markersize=6,
            linewidth=0,
            label=variant,
        )
        for variant, (colour, shape) in zip(variants, _MARKS, strict=False)
    ]
