"""The kept deployments as one picture: what servers save, over the load of the drone's own computer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from bench.deployments import CHANCES, Flown

from upwash.lab.figures.style import DASHES, PAGE_IN, grid, in_style, legend, new_figure, write
from upwash.report.palette import LIGHT

_SHOWN = (0.08, 15.0)  # loads


@in_style
def draw(figures: Sequence[Flown], files: Iterable[Path]) -> None:
    """Draws a mark for each deployment, without demands and with, beside the most that can be saved on rows."""
    figure = new_figure(PAGE_IN / 2, 2.4)
    axes = figure.subplots()
    loads = np.geomspace(*_SHOWN, 200)
    most = 100 * np.maximum(0.0, 1 - 1 / loads)
    axes.plot(loads, most, color=LIGHT.soft, linestyle=DASHES[0], label="1 - 1 / load")
    for number, chance in enumerate(CHANCES):
        axes.plot(
            [flown.load for flown in figures],
            [100 * (1 - flown.served_min[number] / flown.alone_min[number]) for flown in figures],
            color=LIGHT.ink,
            linestyle="none",
            marker="os"[number],
            markerfacecolor=LIGHT.ink if number == 0 else LIGHT.paper,
            markersize=4.5,
            label=f"{100 * chance:.0f} % of the answers demand 10 s" if chance else "no demands",
        )
    axes.set_xscale("log")
    axes.set_xticks([0.1, 0.3, 1, 3, 10], ["0.1", "0.3", "1", "3", "10"])
    axes.minorticks_off()
    axes.set_xlim(*_SHOWN)
    axes.set_xlabel("load: the drone's seconds for a photo\ntimes its photos a second")
    axes.set_ylabel("saved by servers (%)")
    grid(axes, along="y")
    legend(figure)
    write(figure, files)
