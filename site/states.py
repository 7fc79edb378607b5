"""Draws the states of a server, and the steps between them, from the table that the drone goes by.

`python site/states.py FILE`, a PNG.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from upwash.core.knowledge.servers import TRANSITIONS, State, Trigger

# Where the states stand in the thesis's figure 3.2 is not printed: what is believed on the left, what is in use on
# the right.
_PLACES: Mapping[State, tuple[float, float]] = {
    State.AVL: (0.0, 2.4),
    State.CHECK: (1.9, 2.4),
    State.AVL_R: (0.0, 0.0),
    State.CHECK_R: (2.9, 0.0),
    State.READY: (4.6, 1.6),
    State.BLACKLISTED: (2.6, 4.0),
}
_INK, _FILL = "#222222", "#e8eefb"
_BEND = 0.16  # of an arrow's length, so that the two directions do not lie upon each other
_LABEL = 0.29  # of an arrow's way from its start is its label
_LABELS = {(State.CHECK_R, State.BLACKLISTED): 0.62}  # where another label is in its way


def draw_states(file: Path) -> None:
    """Draws every step of the table as an arrow with the triggers that take it."""
    figure = Figure(figsize=(10.0, 7.4), layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlim(-0.6, 5.1)
    axes.set_ylim(-0.7, 4.3)
    axes.axis("off")
    boxes = {state: _draw_state(axes, state) for state in _PLACES}
    figure.draw_without_rendering()  # arrows end at boxes, whose size is that of their texts
    for (before, after), triggers in steps().items():
        _draw_step(axes, before, after, triggers, boxes)
    figure.savefig(file, dpi=130)


def steps() -> dict[tuple[State, State], list[Trigger]]:
    """The triggers of each step from one state to another."""
    steps: dict[tuple[State, State], list[Trigger]] = {}
    for (before, trigger), after in TRANSITIONS.items():
        steps.setdefault((before, after), []).append(trigger)
    return steps


def _draw_state(axes: Axes, state: State) -> FancyBboxPatch | None:
    text = axes.text(
        *_PLACES[state],
        state,
        ha="center",
        va="center",
        fontsize=12,
        fontweight="bold",
        color=_INK,
        bbox={"boxstyle": "round,pad=0.6", "facecolor": _FILL, "edgecolor": _INK},
        zorder=3,
    )
    return text.get_bbox_patch()


def _draw_step(
    axes: Axes,
    before: State,
    after: State,
    triggers: list[Trigger],
    boxes: Mapping[State, FancyBboxPatch | None],
) -> None:
    text = "\n".join(triggers)
    if before is after:
        x, y = _PLACES[before]
        axes.text(x, y - 0.35, f"{text}: stays", ha="center", va="center", fontsize=8, color=_INK)
        return
    start, end = _PLACES[before], _PLACES[after]
    axes.annotate(
        "",
        xy=end,
        xytext=start,
        arrowprops={
            "arrowstyle": "-|>",
            "color": _INK,
            "patchA": boxes[before],
            "patchB": boxes[after],
            "shrinkA": 2,
            "shrinkB": 2,
            "connectionstyle": f"arc3,rad={_BEND}",
        },
    )
    along = (end[0] - start[0], end[1] - start[1])
    share = _LABELS.get((before, after), _LABEL)
    aside = 2 * share * (1 - share) * _BEND  # of the curve, which is a quadratic Bézier's
    place = (start[0] + share * along[0] + aside * along[1], start[1] + share * along[1] - aside * along[0])
    axes.text(
        *place,
        text,
        ha="center",
        va="center",
        fontsize=8,
        color=_INK,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none"},
        zorder=4,
    )


if __name__ == "__main__":
    draw_states(Path(sys.argv[1]))
