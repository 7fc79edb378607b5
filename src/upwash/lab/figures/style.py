"""How every figure looks, and how it is written: text stays text, and the same figure is the same bytes.

Sizes are those of a journal's page: a column is 3.5 inches wide, a page 7.2. Colours are those of pages and reports.
Every colour has a shape or a name beside it, and no text is cut at the edge or lies on another.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from upwash.report.palette import LIGHT
from upwash.support.loading import extra
from upwash.support.output_files import write_file

with extra("figures"):
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

COLUMN_IN, PAGE_IN = 3.5, 7.2
SHAPES = ("s", "^", "D", "v", "p")  # of servers, in the order of their names; the flight page has the same
DASHES = ((0, (5, 3)), (0, (1.5, 2)), (0, (9, 2, 2, 2)))  # of their ranges, likewise
_COLUMNS = 4  # of a legend, at most
_FREE_IN = 0.1  # around a legend
_LONGEST_NAME = 50  # characters of a line in a legend
_DOTS_PER_INCH = 200
_RC: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # which comes with matplotlib
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.6,
    "axes.edgecolor": LIGHT.soft,
    "axes.labelcolor": LIGHT.ink,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": LIGHT.ink,
    "xtick.color": LIGHT.soft,
    "ytick.color": LIGHT.soft,
    "xtick.labelcolor": LIGHT.ink,
    "ytick.labelcolor": LIGHT.ink,
    "grid.color": LIGHT.line,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "legend.title_fontsize": 7.5,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.2,
    "errorbar.capsize": 2.0,
    "pdf.fonttype": 42,  # TrueType: text can be searched and edited
    "svg.fonttype": "none",  # text elements
    "svg.hashsalt": "upwash",
}
_NO_DATES = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
Drawing = TypeVar("Drawing", bound=Callable[..., None])


def in_style(draw: Drawing) -> Drawing:
    """Has a function draw, and write, in the common style."""

    @functools.wraps(draw)
    def drawn(*arguments: object, **options: object) -> None:
        with mpl.rc_context(_RC):
            draw(*arguments, **options)

    return drawn  # type: ignore[return-value]


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure, which arranges what is drawn into it."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def write(figure: Figure, files: Iterable[Path]) -> None:
    """Writes the figure into each file, in the format of its suffix; raises NotWritten."""
    for file in files:
        drawn, written_as = io.BytesIO(), file.suffix[1:]
        figure.savefig(drawn, dpi=_DOTS_PER_INCH, format=written_as, metadata=_NO_DATES[written_as])
        write_file(file, drawn.getvalue())


def legend(figure: Figure, **options: Any) -> None:
    """Puts the names of all marks below the figure, which becomes higher by that much."""
    found = [axes.get_legend_handles_labels() for axes in figure.axes]
    marks = [mark for own, _ in found for mark in own]
    names = [wrapped(name, _LONGEST_NAME) for _, own in found for name in own]
    for columns in range(min(len(marks), _COLUMNS), 0, -1):
        shown = figure.legend(marks, names, loc="outside lower center", ncols=columns, **options)
        extent = shown.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
        if extent.width <= figure.get_figwidth() - _FREE_IN or columns == 1:
            figure.set_figheight(figure.get_figheight() + extent.height + _FREE_IN)
            return
        shown.remove()


def wrapped(text: str, most: int) -> str:
    """The text in lines of at most `most` characters; only a longer word is broken, after one of the marks ,.=_-"""
    lines = [""]
    for word in text.split():
        parts = (
            [word]
            if len(word) <= most
            else re.findall(rf"[^,.=_-]{{0,{most - 1}}}[,.=_-]|[^,.=_-]{{1,{most}}}", word)
        )
        for part in parts:
            gap = " " if lines[-1] and part is parts[0] else ""
            if lines[-1] and len(lines[-1]) + len(gap) + len(part) > most:
                lines.append(part)
            else:
                lines[-1] += gap + part
    return "\n".join(lines)


def few_ticks(axis: Axis, *, most: int, whole: bool = False) -> None:
    """Gives the axis round numbers, at most that many; with `whole` no fractions."""
    axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10], integer=whole))


def grid(axes: Axes, *, along: str) -> None:
    """Thin lines across the axis `along`, "x" or "y"."""
    axes.grid(axis="x" if along == "x" else "y")
