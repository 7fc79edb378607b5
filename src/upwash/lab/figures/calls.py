"""The delays of a mission's calls by waypoint, drawn beside a mission that offloads nothing: figure 4.5's form."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from upwash.core.geo import Position
from upwash.core.knowledge.servers import CHECKING
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.eventlog.schema import Event
from upwash.lab.figures.style import (
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
from upwash.support.text import by_name


class DrawnWait(Enum):
    """What was decided about a server that was not ready yet, and what came of it."""

    NOT_ASKED = ""
    WAITED = "waited for a server"
    IN_VAIN = "waited, ran on the drone"
    DECLINED = "did not wait"


@dataclass(frozen=True, slots=True)
class CallPoint:
    """One call as it is drawn."""

    waypoint: int
    delay_s: float
    server: str | None  # None for the drone
    wait: DrawnWait


def read_call_points(events: Iterable[Event]) -> Iterator[CallPoint]:
    """The calls at waypoints, in the order of the events."""
    whereabouts = CallPlaces()
    decided: schema.Decided | None = None  # the first decision of the call; another follows a wait
    for event in events:
        whereabouts.take(event)
        match event:
            case schema.Decided():
                decided = decided or event
            case schema.Call():
                if whereabouts.of_call is not None and decided is not None:
                    yield CallPoint(whereabouts.of_call, event.delay_s, event.server, _wait(decided, event))
                decided = None


def _wait(decided: schema.Decided, call: schema.Call) -> DrawnWait:
    if call.wait:
        return DrawnWait.IN_VAIN if call.wait == "failed" else DrawnWait.WAITED
    if decided.decision == "local" and decided.state in CHECKING:
        return DrawnWait.DECLINED
    return DrawnWait.NOT_ASKED


@dataclass(frozen=True, slots=True)
class Strip:
    """One server: the runs of waypoints in its range, and of those whose calls ran there, as first and last."""

    server: str
    in_range: Sequence[tuple[int, int]]
    used: Sequence[tuple[int, int]]


def strips(events: Iterable[Event], calls: Iterable[CallPoint]) -> list[Strip]:
    """The strips of the servers that the mission knew, by name; one without a range has none that is pale."""
    plan = next((event for event in events if isinstance(event, schema.Planned)), schema.Planned(t=0.0))
    ran_at: dict[str, set[int]] = {server: set() for server in (*plan.ranges, *plan.measured)}
    for call in calls:
        if call.server is not None:
            ran_at.setdefault(call.server, set()).add(call.waypoint)
    return [
        Strip(
            server,
            _runs(
                index
                for index, (east_m, north_m) in enumerate(plan.waypoints_m)
                if server in plan.ranges and plan.ranges[server].contains(Position(east_m, north_m))
            ),
            _runs(ran_at[server]),
        )
        for server in sorted(ran_at, key=by_name)
    ]


def _runs(waypoints: Iterable[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for waypoint in sorted(waypoints):
        if found and waypoint == found[-1][1] + 1:
            found[-1] = (found[-1][0], waypoint)
        else:
            found.append((waypoint, waypoint))
    return found


_DELAYS_IN, _STRIP_IN, _LINE_IN, _REST_IN = 1.9, 0.17, 0.13, 0.6
_LONGEST_NAME, _LONGEST_TITLE = 24, 100  # characters of a line
_TICKS = 10
_BAND = (5, 95)  # percent of the missions
_HOLLOW = {"facecolors": "none", "edgecolors": LIGHT.ink, "linewidths": 0.9}
_WAITS: Mapping[DrawnWait, Mapping[str, Any]] = {  # marks around the call's own: each has a shape
    DrawnWait.WAITED: {"marker": "o", "s": 62, **_HOLLOW},
    DrawnWait.IN_VAIN: {"marker": "s", "s": 70, **_HOLLOW},
    DrawnWait.DECLINED: {"marker": "x", "s": 34, "color": LIGHT.ink, "linewidths": 1.0},
}


@in_style
def draw_call_delays(
    events: Sequence[Event],
    *,
    reference: Iterable[Event],
    files: Iterable[Path],
    title: str = "",
    others: Sequence[Sequence[Event]] = (),
) -> None:
    """Draws the mission with its local-only `reference`, and the spread of `others`, flown with other seeds.

    Beneath the delays each server has a strip: pale where a waypoint is in its range, full where the call ran there.
    """
    calls, alone = list(read_call_points(events)), list(read_call_points(reference))
    servers = strips(events, calls)
    names = [wrapped(strip.server, _LONGEST_NAME) for strip in servers]
    row_in = _STRIP_IN + _LINE_IN * max((name.count("\n") for name in names), default=0)
    heights_in = [_DELAYS_IN, *([row_in * len(servers)] if servers else [])]
    figure = new_figure(PAGE_IN, sum(heights_in) + _REST_IN)
    columns = figure.subplots(len(heights_in), 1, sharex=True, squeeze=False, height_ratios=heights_in)
    delays, lowest = columns[0, 0], columns[-1, 0]
    _draw_spread(delays, [list(read_call_points(other)) for other in others])
    _draw_delays(delays, calls, alone, [strip.server for strip in servers])
    if servers:
        _draw_strips(lowest, servers)
        lowest.set_yticks(range(len(servers)), names)
        delays.tick_params(axis="x", length=0)
    last = max((call.waypoint for call in calls + alone), default=0)
    delays.set_xlim(-1.5, last + 1.5)
    few_ticks(lowest.xaxis, most=_TICKS, whole=True)
    delays.set_title(wrapped(title, _LONGEST_TITLE))
    meant = (
        "; strips: pale where it is in range of the server, full where its call ran there" if servers else ""
    )
    lowest.set_xlabel(f"waypoint{meant}")
    legend(figure)
    write(figure, files)


def _draw_delays(
    axes: Axes, calls: Sequence[CallPoint], alone: Sequence[CallPoint], servers: Sequence[str]
) -> None:
    axes.plot(*_line(alone), color=LIGHT.places[0], linestyle=(0, (3, 1.5)), label="every call on the drone")
    axes.plot(*_line(calls), color=LIGHT.soft, linewidth=0.8)
    for place in (None, *servers):
        own = [call for call in calls if call.server == place]
        if not own:
            continue
        index = 0 if place is None else servers.index(place)
        axes.scatter(
            *_line(own),
            s=11,
            marker="o" if place is None else SHAPES[index % len(SHAPES)],
            color=LIGHT.places[0] if place is None else LIGHT.of_server(index),
            linewidths=0,
            zorder=3,
            label="on the drone" if place is None else f"on {place}",
        )
    for wait, look in _WAITS.items():
        own = [call for call in calls if call.wait is wait]
        if own:
            axes.scatter(*_line(own), zorder=4, label=wait.value, **look)
    highest_s = max((call.delay_s for call in (*calls, *alone)), default=1.0)
    axes.set_ylim(0, 1.1 * highest_s)
    axes.set_ylabel("call delay (s)")
    grid(axes, along="y")


def _line(calls: Sequence[CallPoint]) -> tuple[list[int], list[float]]:
    return [call.waypoint for call in calls], [call.delay_s for call in calls]


def _draw_spread(axes: Axes, missions: Sequence[Sequence[CallPoint]]) -> None:
    by_waypoint: dict[int, list[float]] = {}
    for call in (call for mission in missions for call in mission):
        by_waypoint.setdefault(call.waypoint, []).append(call.delay_s)
    if not by_waypoint:
        return
    waypoints = sorted(by_waypoint)
    low_s, high_s = np.array([np.percentile(by_waypoint[waypoint], _BAND) for waypoint in waypoints]).T
    axes.fill_between(
        waypoints,
        low_s,
        high_s,
        step="mid",
        color=LIGHT.line,
        linewidth=0,
        label=f"{_BAND[0]} to {_BAND[1]} % of {len(missions)} missions",
    )


def _draw_strips(axes: Axes, servers: Sequence[Strip]) -> None:
    for row, strip in enumerate(servers):
        for runs, height, opacity in ((strip.in_range, 0.76, 0.25), (strip.used, 0.4, 1.0)):
            axes.broken_barh(
                [(first - 0.5, last - first + 1) for first, last in runs],
                (row - height / 2, height),
                color=LIGHT.of_server(row),
                alpha=opacity,
                linewidth=0,
            )
    axes.set_ylim(len(servers) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
