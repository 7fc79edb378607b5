"""The waypoints by the servers that cover them, the ranges, and the way of the flight: the form of figure 4.4."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from upwash.config.drone import DroneConfig
from upwash.config.places import server_areas
from upwash.core.geo import Circle, Position
from upwash.drone.preparation import order_of
from upwash.lab.figures.style import (
    COLUMN_IN,
    DASHES,
    PAGE_IN,
    SHAPES,
    few_ticks,
    in_style,
    legend,
    new_figure,
    wrapped,
    write,
)
from upwash.missions.bundled import load_specs
from upwash.report.palette import LIGHT
from upwash.support.text import by_name

_REST_IN, _LINE_IN = 0.6, 0.16  # left of the map and below it, and a line of the title
_LOW, _HIGH = 0.15, 1.4  # the map's height, of its width: at least and at most
_WIDE = 0.5  # a map that is less high, of its width, takes a page
_LONGEST_NAME, _LONGEST_TITLE = 20, 46  # characters of a line
_TICKS = 6
_ASIDE, _STEPS = 4, 9  # steps that a name may be moved sideways, and up or down
_MARK_PT, _COVERED_PT = 1.5, 12.0  # around a waypoint, and how far a name is moved so as not to cover it
_MOST_PT = 60.0  # of both together: a name that would be farther away is left out

_ARROW = {"arrowstyle": "-|>", "color": LIGHT.soft, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3}
_CENTRE: Mapping[str, Any] = {"marker": "+", "markersize": 6, "markeredgewidth": 1.4, "zorder": 5}
_SEVERAL, _NONE = -1, -2  # in place of a server's index


@in_style
def draw_coverage(config: DroneConfig, files: Iterable[Path], *, title: str = "") -> None:
    """Draws the map of the mission as it is flown."""
    places = [waypoint.position for waypoint in order_of(config, load_specs(config.services)).waypoints]
    reaches = server_areas(config)
    servers = sorted(reaches, key=by_name)  # which have their colours in this order, with a range or without
    areas = {index: area for index, name in enumerate(servers) if isinstance(area := reaches[name], Circle)}
    height = _height(places, areas.values())
    width_in = COLUMN_IN if height >= _WIDE else PAGE_IN
    head = wrapped(title, _LONGEST_TITLE)
    head_in = _LINE_IN * (1 + head.count("\n")) if title else 0.0
    figure = new_figure(width_in, head_in + _REST_IN + (width_in - _REST_IN) * min(_HIGH, max(_LOW, height)))
    axes = figure.subplots()
    for start, end in _straights(places):
        axes.annotate(
            "",
            xy=(end.east_m, end.north_m),
            xytext=(start.east_m, start.north_m),
            arrowprops=_ARROW,
        )
    _draw_areas(axes, areas)
    _draw_waypoints(axes, places, servers, areas)
    axes.set_aspect("equal", adjustable="datalim")
    few_ticks(axes.xaxis, most=_TICKS)
    few_ticks(axes.yaxis, most=_TICKS)
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title(head)
    legend(figure, title="waypoints in range of", handlelength=3.6)
    figure.draw_without_rendering()  # which settles where everything is
    _name_areas(axes, places, servers, areas)
    write(figure, files)


def _height(places: Sequence[Position], areas: Iterable[Circle]) -> float:
    """The height of all that is drawn, of its width."""
    ends = [(place.east_m, place.north_m) for place in places]
    for area in areas:
        east_m, north_m, radius_m = area.centre.east_m, area.centre.north_m, area.radius_m
        ends += [(east_m - radius_m, north_m - radius_m), (east_m + radius_m, north_m + radius_m)]
    wide_m, high_m = np.ptp(ends, axis=0)
    return float(high_m / wide_m) if wide_m else _HIGH


def _draw_areas(axes: Axes, areas: Mapping[int, Circle]) -> None:
    for index, area in areas.items():
        centre, (_, dashes, colour, _) = area.centre, _look(index)
        angles = [math.tau * step / 180 for step in range(181)]
        easts_m = [centre.east_m + area.radius_m * math.cos(angle) for angle in angles]
        norths_m = [centre.north_m + area.radius_m * math.sin(angle) for angle in angles]
        axes.plot(easts_m, norths_m, color=colour, linestyle=dashes, linewidth=1.0)
        axes.plot(centre.east_m, centre.north_m, **_CENTRE, color=colour)


def _name_areas(
    axes: Axes, places: Sequence[Position], servers: Sequence[str], areas: Mapping[int, Circle]
) -> None:
    """Write the name of each server beside its middle: not over another name, and over as few waypoints as possible.

    A name without room is left out; the legend has it.
    """
    centres = [area.centre for area in areas.values()]
    to_pt = 72 / axes.figure.dpi
    marks = axes.transData.transform([(at.east_m, at.north_m) for at in (*centres, *places)]) * to_pt
    frame = np.array(axes.get_window_extent().get_points()) * to_pt
    taken: list[Bbox] = []
    for index, centre in zip(areas, marks, strict=False):
        name = axes.annotate(
            wrapped(servers[index], _LONGEST_NAME),
            xy=(areas[index].centre.east_m, areas[index].centre.north_m),
            xytext=(0, 0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontweight="bold",
            color=LIGHT.of_server(index),
            zorder=6,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": LIGHT.paper, "edgecolor": "none", "alpha": 0.85},
            arrowprops={"arrowstyle": "-", "color": LIGHT.of_server(index), "linewidth": 0.6, "shrinkB": 3},
        )
        size_pt = np.array(Text.get_window_extent(name).size) * to_pt
        best: tuple[float, Bbox, tuple[float, float] | None] = (_MOST_PT, Bbox.null(), None)
        for moved in _ways(*size_pt):
            low, high = centre + moved - size_pt / 2, centre + moved + size_pt / 2
            box = Bbox([low, high])
            if box.count_overlaps(taken) or (low < frame[0]).any() or (high > frame[1]).any():
                continue
            covered = np.all((marks > low - _MARK_PT) & (marks < high + _MARK_PT), axis=1).sum()
            cost = _COVERED_PT * covered + math.hypot(*moved)
            best = min(best, (cost, box, moved), key=itemgetter(0))
        _, box, chosen = best
        if chosen is None:
            name.remove()
        else:
            taken.append(box)
            name.set_position(chosen)


def _ways(width_pt: float, height_pt: float) -> Iterator[tuple[float, float]]:
    for right, up in itertools.product(range(-_ASIDE, 1 + _ASIDE), range(-_STEPS, 1 + _STEPS)):
        yield right * width_pt / _ASIDE, up * height_pt / 2


def _draw_waypoints(
    axes: Axes, places: Sequence[Position], servers: Sequence[str], areas: Mapping[int, Circle]
) -> None:
    """Draw a mark for each group: in one server's range, in several, in none."""
    members: dict[int, list[Position]] = {}  # by the index of the only server
    for place in places:
        covering = [index for index, area in areas.items() if area.contains(place)]
        group = _NONE if not covering else _SEVERAL if len(covering) > 1 else covering[0]
        members.setdefault(group, []).append(place)
    looks = {
        **{index: (f"{servers[index]} alone", *_look(index)) for index in areas},
        _SEVERAL: ("several", "o", "", LIGHT.ink, LIGHT.ink),
        _NONE: ("none", "o", "", LIGHT.places[0], LIGHT.paper),
    }
    for group, (name, shape, dashes, colour, fill) in looks.items():
        own = members.get(group, [])
        look: Mapping[str, Any] = {
            "marker": shape,
            "color": colour,
            "markerfacecolor": fill,
            "markersize": 4.0,
            "markeredgewidth": 0.7,
        }
        axes.plot(
            [place.east_m for place in own], [place.north_m for place in own], **look, linestyle="", zorder=4
        )
        if own or group >= 0:  # a range has the same dashes
            axes.plot([], [], **look, linestyle=dashes, linewidth=1.0, label=f"{name} ({len(own)})")


def _look(index: int) -> tuple[str, Any, str, str]:
    colour = LIGHT.of_server(index)
    return SHAPES[index % len(SHAPES)], DASHES[index % len(DASHES)], colour, colour


def _straights(places: Sequence[Position]) -> Iterator[tuple[Position, Position]]:
    """The legs of the flight, with consecutive legs of one heading joined."""

    def heading_deg(leg: tuple[Position, Position]) -> int:
        start, end = leg
        return round(math.degrees(math.atan2(end.east_m - start.east_m, end.north_m - start.north_m)))

    legs = [leg for leg in itertools.pairwise(places) if leg[0] != leg[1]]
    for _, run in itertools.groupby(legs, key=heading_deg):
        straight = list(run)
        yield straight[0][0], straight[-1][1]
