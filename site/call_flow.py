"""Draws what happens to a call of a mission: `python site/call_flow.py FILE`, a PNG."""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

_INK, _PLAIN, _DRONE, _SERVER = "#222222", "#ffffff", "#e8eefb", "#fdf0e0"
_BOXES = {  # where its middle is, the text, the colour
    "mission": ((1.0, 3.0), "the mission calls\ndetector.process_photo(photo)", _PLAIN),
    "policy": ((3.6, 3.0), "the policy asks:\nis a server ready, and faster?", _PLAIN),
    "server": ((6.3, 4.2), "the server computes,\nuntil the call's deadline", _SERVER),
    "wait": ((6.3, 3.0), "wait for a server\nthat is nearly ready", _PLAIN),
    "drone": ((6.3, 1.7), "the drone computes", _DRONE),
    "answer": ((9.2, 3.0), "the mission has\nits answer", _PLAIN),
}
_ARROWS = (  # from, to, what is written there, and where
    ("mission", "policy", "", (0.0, 0.0)),
    ("policy", "server", "yes", (4.75, 3.8)),
    ("policy", "wait", "soon", (5.1, 3.12)),
    ("policy", "drone", "no", (4.75, 2.2)),
    ("wait", "server", "ready", (6.05, 3.6)),
    ("wait", "drone", "not in time", (5.88, 2.35)),
    ("server", "answer", "in time", (8.05, 3.8)),
    ("drone", "answer", "", (0.0, 0.0)),
)
_FAILED = "late, lost, refused or wrong"


def draw_call_flow(file: Path) -> None:
    """Draws the ways that a call may take."""
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlim(0.0, 10.0)
    axes.set_ylim(1.3, 4.6)
    axes.axis("off")
    boxes = {name: _draw_box(axes, place, text, colour) for name, (place, text, colour) in _BOXES.items()}
    figure.draw_without_rendering()  # arrows end at boxes, whose size is that of their texts
    for start, end, text, place in _ARROWS:
        _draw_arrow(axes, boxes[start], boxes[end])
        axes.text(*place, text, ha="center", va="center", fontsize=8, color=_INK)
    _draw_arrow(axes, boxes["server"], boxes["drone"], linestyle="--", connectionstyle="arc3,rad=-0.75")
    axes.text(7.55, 2.95, _FAILED.replace(" or ", "\nor "), ha="left", va="center", fontsize=8, color=_INK)
    figure.savefig(file, dpi=130)


def _draw_box(axes: Axes, place: tuple[float, float], text: str, colour: str) -> Text:
    box = {"boxstyle": "round,pad=0.5", "facecolor": colour, "edgecolor": _INK, "linewidth": 0.8}
    return axes.text(*place, text, ha="center", va="center", fontsize=8.5, color=_INK, bbox=box, zorder=2)


def _draw_arrow(axes: Axes, start: Text, end: Text, **style: str) -> None:
    axes.annotate(
        "",
        end.get_position(),
        start.get_position(),
        arrowprops={
            "arrowstyle": "-|>",
            "color": _INK,
            "linewidth": 0.9,
            "patchA": start.get_bbox_patch(),
            "patchB": end.get_bbox_patch(),
            **style,
        },
        zorder=1,
    )


if __name__ == "__main__":
    draw_call_flow(Path(sys.argv[1]))
