"""Pictures of simulated missions, in the form of the thesis's figures 4.4 to 4.12."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from upwash.config import DroneConfig, server_areas
from upwash.core.geo import Circle, Position
from upwash.core.servers import CHECKING
from upwash.drone.order import order_of
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.eventlog.whereabouts import Whereabouts
from upwash.missions.bundled import load_specs
from upwash.support.loading import extra
from upwash.support.output_files import write_file

with extra("figures"):
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OFFLOADING, _LOCAL_ONLY, _INK = "#1f5fc4", "#9b9b9b", "#222222"
_SERVERS = ("#e09f1f", "#8a63c7", "#2a9d8f", "#c65d7b", "#5b7f95", "#7f8c2f")
_UNCOVERED, _SEVERAL = "#b5b5b5", "#7b4a2b"
_WAITED, _DECLINED = "#1f9d3a", "#d62728"
_DOTS_PER_INCH = 160
_TOP, _BETWEEN = 0.62, 0.14  # height of the first server's area, and of the steps down to the others'
_LEAST = 0.2


class Wait(Enum):
    """What was decided about a server that was not ready yet."""

    NOT_ASKED = ""
    WAITED = "decided to wait"
    DECLINED = "decided not to wait"


@dataclass(frozen=True, slots=True)
class CallPoint:
    """One call as it is drawn."""

    waypoint: int
    delay_s: float
    server: str | None  # None for the drone
    wait: Wait


def read_call_points(events: Iterable[Event]) -> Iterator[CallPoint]:
    """The calls at waypoints, in the order of the events."""
    whereabouts = Whereabouts()
    decided: schema.Decided | None = None  # the first decision of the call; another follows a wait
    for event in events:
        whereabouts.take(event)
        match event:
            case schema.Decided():
                decided = decided or event
            case schema.Call():
                if whereabouts.of_call is not None and decided is not None:
                    yield CallPoint(whereabouts.of_call, event.delay_s, event.server, _wait(decided))
                decided = None


def _wait(decided: schema.Decided) -> Wait:
    if decided.decision == "wait":
        return Wait.WAITED
    if decided.decision == "local" and decided.state in CHECKING:
        return Wait.DECLINED
    return Wait.NOT_ASKED


def draw_call_delays(
    events: Iterable[Event],
    *,
    reference: Iterable[Event],
    file: Path,
    title: str = "",
) -> None:
    """Draws the call delay at each waypoint of a mission and of its local-only reference, as in figure 4.5."""
    calls, alone = list(read_call_points(events)), list(read_call_points(reference))
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    axes = figure.add_subplot()
    highest_s = max((call.delay_s for call in calls + alone), default=1.0)
    _draw_usage(axes, calls, highest_s)
    for points, colour, label in ((alone, _LOCAL_ONLY, "no offloading"), (calls, _OFFLOADING, "offloading")):
        axes.plot(
            [point.waypoint for point in points],
            [point.delay_s for point in points],
            color=colour,
            linewidth=1.5,
            label=label,
            solid_joinstyle="round",
        )
    for wait, colour in ((Wait.WAITED, _WAITED), (Wait.DECLINED, _DECLINED)):
        points = [call for call in calls if call.wait is wait]
        axes.scatter(
            [point.waypoint for point in points],
            [point.delay_s for point in points],
            s=38,
            color=colour,
            edgecolors="white",
            linewidths=0.8,
            zorder=4,
            label=wait.value,
        )
    axes.set_xlim(-1.5, max((call.waypoint for call in calls + alone), default=0) + 1.5)
    axes.set_ylim(0, 1.08 * highest_s)
    axes.set_xlabel("waypoint")
    axes.set_ylabel("call delay (s)")
    axes.grid(axis="y", color="#e4e4e4", linewidth=0.8)
    _finish(figure, axes, title, file, legend_columns=6)


def _draw_usage(axes: Axes, calls: Sequence[CallPoint], highest_s: float) -> None:
    servers = sorted({call.server for call in calls if call.server is not None})
    for index, server in enumerate(servers):
        colour = _SERVERS[index % len(_SERVERS)]
        level_s = highest_s * max(_LEAST, _TOP - index * _BETWEEN)
        label: str | None = f"calls on {server}"
        for first, last in _stretches(calls, server):
            edges = [first - 0.5, last + 0.5]
            axes.fill_between(edges, 0, level_s, color=colour, alpha=0.2, linewidth=0, label=label)
            axes.plot(
                [edges[0], *edges, edges[1]],
                [0, level_s, level_s, 0],
                color=colour,
                linestyle=(0, (4, 2)),
                linewidth=1.1,
            )
            label = None


def _stretches(calls: Sequence[CallPoint], server: str) -> Iterator[tuple[int, int]]:
    """The first and last waypoint of each run of calls on the server."""
    for place, run in itertools.groupby(calls, key=lambda call: call.server):
        if place == server:
            stretch = [call.waypoint for call in run]
            yield stretch[0], stretch[-1]


def draw_map(config: DroneConfig, file: Path, title: str = "") -> None:
    """Draws the waypoints by the servers that cover them, the ranges and the way of the flight, as figure 4.4."""
    places = [each.position for each in order_of(config, load_specs(config.services)).waypoints]
    areas = server_areas(config)
    figure = Figure(figsize=(6.6, 7.0), layout="constrained")
    axes = figure.add_subplot()
    for start, end in _straights(places):
        axes.annotate(
            "",
            xy=(end.east_m, end.north_m),
            xytext=(start.east_m, start.north_m),
            arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 5},
        )
    _draw_areas(axes, areas)
    _draw_waypoints(axes, places, areas)
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    _finish(figure, axes, title, file, legend_columns=2)


def _draw_areas(axes: Axes, areas: Mapping[str, Circle]) -> None:
    for index, (name, area) in enumerate(areas.items()):
        colour = _SERVERS[index % len(_SERVERS)]
        angles = [math.tau * step / 180 for step in range(181)]
        axes.plot(
            [area.centre.east_m + area.radius_m * math.cos(angle) for angle in angles],
            [area.centre.north_m + area.radius_m * math.sin(angle) for angle in angles],
            color=colour,
            linestyle=(0, (5, 3)),
            linewidth=1.6,
        )
        place = (area.centre.east_m, area.centre.north_m)
        axes.plot(*place, marker="^", markersize=11, color=colour, markeredgecolor=_INK, zorder=5)
        axes.annotate(
            name,
            xy=place,
            xytext=(9, 6),
            textcoords="offset points",
            fontweight="bold",
            zorder=6,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
        )


def _draw_waypoints(axes: Axes, places: Sequence[Position], areas: Mapping[str, Circle]) -> None:
    names = list(areas)
    groups: dict[tuple[str, str], list[Position]] = {}
    for place in places:
        covering = [name for name in names if areas[name].contains(place)]
        if not covering:
            group = ("out of every range", _UNCOVERED)
        elif len(covering) > 1:
            group = ("in range of several", _SEVERAL)
        else:
            group = (f"in range of {covering[0]}", _SERVERS[names.index(covering[0]) % len(_SERVERS)])
        groups.setdefault(group, []).append(place)
    for (label, colour), members in sorted(groups.items()):
        axes.scatter(
            [place.east_m for place in members],
            [place.north_m for place in members],
            s=42,
            color=colour,
            edgecolors="white",
            linewidths=0.7,
            zorder=4,
            label=f"{label} ({len(members)})",
        )


def _straights(places: Sequence[Position]) -> Iterator[tuple[Position, Position]]:
    """The flight as straight lines: legs of the same heading, one after the other, are one."""
    legs = [leg for leg in itertools.pairwise(places) if leg[0] != leg[1]]
    for _, run in itertools.groupby(legs, key=lambda leg: _heading_deg(*leg)):
        straight = list(run)
        yield straight[0][0], straight[-1][1]


def _heading_deg(start: Position, end: Position) -> int:
    return round(math.degrees(math.atan2(end.east_m - start.east_m, end.north_m - start.north_m)))


def _finish(figure: Figure, axes: Axes, title: str, file: Path, *, legend_columns: int) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(title, loc="left", fontsize=11, pad=10)
    figure.legend(
        loc="outside lower center", ncols=legend_columns, frameon=False, fontsize=9, handlelength=1.8
    )
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=_DOTS_PER_INCH, format=file.suffix[1:])
    write_file(file, drawn.getvalue())
