"""How every figure looks, and how it is written: text stays text, and the same figure is the same bytes.

Sizes are those of a journal's page: a column is 3.5 inches wide, a page 7.2. Colours are those of pages and reports.
Every colour has a shape or a name beside it.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from upwash.report.palette import LIGHT
from upwash.support.loading import extra
from upwash.support.output_files import write_file

with extra("figures"):
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN_IN, PAGE_IN = 3.5, 7.2
SHAPES = ("s", "^", "D", "v", "p", "P", "X", "h")  # of servers, in the order of their names
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
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.2,
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


def legend(figure: Figure, *, columns: int) -> None:
    """Puts the names of all marks below the figure."""
    if any(axes.get_legend_handles_labels()[0] for axes in figure.axes):
        figure.legend(loc="outside lower center", ncols=columns)


def grid(axes: Axes, *, along: str) -> None:
    """Thin lines across the axis `along`, "x" or "y"."""
    axes.grid(axis="x" if along == "x" else "y")
