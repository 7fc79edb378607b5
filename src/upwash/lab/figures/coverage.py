"""The waypoints by the servers that cover them, the ranges, and the way of the flight: the form of figure 4.4."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes

from upwash.config import DroneConfig, server_areas
from upwash.core.geo import Circle, Position
from upwash.drone.preparation import order_of
from upwash.lab.figures.style import COLUMN_IN, SHAPES, in_style, legend, new_figure, write
from upwash.missions.bundled import load_specs
from upwash.report.palette import LIGHT

_HEIGHT_IN = 3.8


@in_style
def draw_coverage(config: DroneConfig, files: Iterable[Path], *, title: str = "") -> None:
    """Draws the map of the mission as it is flown."""
    places = [waypoint.position for waypoint in order_of(config, load_specs(config.services)).waypoints]
    areas = {name: area for name, area in server_areas(config).items() if isinstance(area, Circle)}
    figure = new_figure(COLUMN_IN, _HEIGHT_IN)
    axes = figure.subplots()
    for start, end in _straights(places):
        axes.annotate(
            "",
            xy=(end.east_m, end.north_m),
            xytext=(start.east_m, start.north_m),
            arrowprops={
                "arrowstyle": "-|>",
                "color": LIGHT.soft,
                "linewidth": 0.6,
                "shrinkA": 0,
                "shrinkB": 3,
            },
        )
    _draw_areas(axes, areas)
    _draw_waypoints(axes, places, areas)
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title(title)
    legend(figure, columns=2)
    write(figure, files)


def _draw_areas(axes: Axes, areas: Mapping[str, Circle]) -> None:
    for index, (name, area) in enumerate(areas.items()):
        angles = [math.tau * step / 180 for step in range(181)]
        axes.plot(
            [area.centre.east_m + area.radius_m * math.cos(angle) for angle in angles],
            [area.centre.north_m + area.radius_m * math.sin(angle) for angle in angles],
            color=LIGHT.of_server(index),
            linestyle=(0, (5, 3)),
            linewidth=1.0,
        )
        axes.annotate(
            name,
            xy=(area.centre.east_m, area.centre.north_m),
            ha="center",
            va="center",
            fontweight="bold",
            color=LIGHT.of_server(index),
            zorder=6,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": LIGHT.paper, "edgecolor": "none", "alpha": 0.9},
        )


def _draw_waypoints(axes: Axes, places: Sequence[Position], areas: Mapping[str, Circle]) -> None:
    """Draw a mark for each group: in one server's range, in several, in none."""
    names = list(areas)
    members: dict[int, list[Position]] = {}  # by the index of the only server; below 0 for several, and none
    for place in places:
        covering = [index for index, name in enumerate(names) if areas[name].contains(place)]
        members.setdefault(covering[0] if len(covering) == 1 else -1 if covering else -2, []).append(place)
    looks = {
        **{
            index: (f"in range of {name}", SHAPES[index % len(SHAPES)], LIGHT.of_server(index), "full")
            for index, name in enumerate(names)
        },
        -1: ("in range of several", "o", LIGHT.ink, "full"),
        -2: ("out of every range", "o", LIGHT.places[0], "hollow"),
    }
    for group in sorted(members, key=lambda index: (index < 0, abs(index))):
        name, shape, colour, fill = looks[group]
        axes.scatter(
            [place.east_m for place in members[group]],
            [place.north_m for place in members[group]],
            s=16,
            marker=shape,
            facecolors=colour if fill == "full" else LIGHT.paper,
            edgecolors=colour,
            linewidths=0.7,
            zorder=4,
            label=f"{name} ({len(members[group])})",
        )


def _straights(places: Sequence[Position]) -> Iterator[tuple[Position, Position]]:
    """The legs of the flight, with consecutive legs of one heading joined."""
    legs = [leg for leg in itertools.pairwise(places) if leg[0] != leg[1]]
    for _, run in itertools.groupby(legs, key=lambda leg: _heading_deg(*leg)):
        straight = list(run)
        yield straight[0][0], straight[-1][1]


def _heading_deg(start: Position, end: Position) -> int:
    return round(math.degrees(math.atan2(end.east_m - start.east_m, end.north_m - start.north_m)))
