"""The flight from above, as SVG: plan, way, ranges, and where the call at each waypoint ran."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.eventlog.narration import named
from upwash.report.axes import figure, label, round_step
from upwash.report.delays import MANY, in_short
from upwash.report.findings import MOST_PICTURED, Finding
from upwash.report.markup import Markup, element, joined
from upwash.report.places import Places
from upwash.report.record import Record

_SIDE, _MARGIN = 560.0, 28.0
_SCALE_BAR = 0.25  # of the width, at most
_FARTHEST = 1e5  # from the map, of what is drawn
_FARTHEST_M = 1e8  # from home, of what the map is to show
_MEASURED_PX, _FULL, _MOSTLY = (
    9.0,
    0.35,
    0.5,
)  # a disc's radius, how opaque one is at most, and with a whole rim
_MOST = 3000  # marks, waypoints or corners of a line that are drawn, more or less


@dataclass(frozen=True, slots=True)
class View:
    """The part of the plane that is shown, north up, in the same scale both ways."""

    west_m: float
    north_m: float
    per_m: float
    width: float
    height: float

    def point(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Where a place is drawn."""
        x, y = (east_m - self.west_m) * self.per_m, (self.north_m - north_m) * self.per_m
        return _MARGIN + _drawable(x), _MARGIN + _drawable(y)


def _drawable(value: float) -> float:
    """A number that a browser can draw, whatever a log says."""
    return min(_FARTHEST, max(-_FARTHEST, value))


def view_of(records: Iterable[Record]) -> View:
    """Shows everything of all of them."""
    west_m = east_m = south_m = north_m = 0.0
    for record in records:
        for x_m, y_m in _corners(record):
            if max(abs(x_m), abs(y_m)) > _FARTHEST_M:
                continue
            west_m, east_m = min(west_m, x_m), max(east_m, x_m)
            south_m, north_m = min(south_m, y_m), max(north_m, y_m)
    breadth_m, depth_m = east_m - west_m, north_m - south_m
    per_m = (_SIDE - 2 * _MARGIN) / max(breadth_m, depth_m, 1.0)
    return View(
        west_m=west_m,
        north_m=north_m,
        per_m=per_m,
        width=max(breadth_m * per_m, 200.0) + 2 * _MARGIN,
        height=depth_m * per_m + 2 * _MARGIN + 24,
    )


def _corners(record: Record) -> Iterator[tuple[float, float]]:
    yield from record.plan.waypoints_m
    for fix in record.track:
        yield fix.position.east_m, fix.position.north_m
    for area in record.plan.ranges.values():
        for sign in (-1, 1):
            yield area.centre.east_m + sign * area.radius_m, area.centre.north_m + sign * area.radius_m


def draw_map(record: Record, places: Places, view: View) -> Markup:
    """The ranges, the plan and the way flown, home, a mark for each call, and a number for each finding."""
    told = f", {len(record.findings)} findings" if record.findings else ""
    return figure(
        f"Map of the flight, {record.name}",
        f"{len(record.plan.waypoints_m)} waypoints planned, {len(record.plan.ranges)} servers' ranges, "
        f"{len(record.calls)} calls{told}; north is up.",
        view.width,
        view.height,
        *_ranges(record, places, view),
        *_measured(record, places, view),
        _line(record.plan.way_m, view, "plan"),
        _line(((fix.position.east_m, fix.position.north_m) for fix in record.track), view, "track"),
        *_waypoints(record, view),
        _home(view),
        *_calls(record, places, view),
        *_turns(record, view),
        *_findings(record.findings, view),
        *_names(record, view),
        _scale(view),
    )


def _ranges(record: Record, places: Places, view: View) -> Iterator[Markup]:
    for name, area in record.plan.ranges.items():
        x, y = view.point(area.centre.east_m, area.centre.north_m)
        style = f"range {places.colour(name)}"
        about = element("title", f"{name}, range {area.radius_m:g} m")
        yield joined(
            element("circle", about, cx=x, cy=y, r=area.radius_m * view.per_m, class_=style),
            element("path", d=f"M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12", class_=f"mast {style}"),
        )


def _measured(record: Record, places: Places, view: View) -> Iterator[Markup]:
    """Where a server without a range was asked something: the fuller, the more was answered."""
    for server, place in record.measured[:_MOST]:
        x, y = view.point(place.east_m, place.north_m)
        share = place.answered / place.tried if place.tried else 0.0
        style = "measured" if share >= _MOSTLY else "measured vain"
        yield element(
            "circle",
            element("title", f"{server}: {_said(place)}"),
            cx=x,
            cy=y,
            r=_MEASURED_PX,
            fill_opacity=round(_FULL * share, 2),
            class_=f"{style} {places.colour(server)}",
        )


def _said(place: schema.MeasuredRecord) -> str:
    """What is known of a server at a place."""
    calls = "".join(f", {operation} {call_s:.2f} s" for operation, call_s in place.call_s.items())
    goodput = "" if place.goodput_bit_s is None else f", {place.goodput_bit_s / 1e6:.1f} Mbit/s"
    return f"answered {place.answered} of {place.tried}{calls}{goodput}"


def _names(record: Record, view: View) -> Iterator[Markup]:
    for name, area in record.plan.ranges.items():
        x, y = view.point(area.centre.east_m, area.centre.north_m)
        yield label(name, x, y - 9, style="row halo")


def _line(places_m: Iterable[tuple[float, float]], view: View, style: str) -> Markup:
    way = _Way()
    for place in places_m:
        way.lead_to(*view.point(*place))
    return element("path", d=way.path(), class_=style)


class _Way:
    """A line on a grid, which gets coarser as the line gets long; what is drawn once is not drawn again."""

    def __init__(self) -> None:
        self._grid = 0.1
        self._at: tuple[int, int] | None = None
        self._strokes: dict[tuple[tuple[int, int], tuple[int, int]], None] = {}  # in their order

    def lead_to(self, x: float, y: float) -> None:
        """The line goes on to that point."""
        at = round(x / self._grid), round(y / self._grid)
        before, self._at = self._at, at
        if before is None or before == at or (at, before) in self._strokes:
            return
        self._strokes[before, at] = None
        while len(self._strokes) > _MOST:
            self._coarsen()

    def _coarsen(self) -> None:
        self._grid *= 2
        halved = [(_halved(start), _halved(end)) for start, end in self._strokes]
        self._strokes = {(start, end): None for start, end in halved if start != end}
        self._at = None if self._at is None else _halved(self._at)

    def path(self) -> str:
        """The line as a path's commands."""
        commands, pen = [], None
        for start, end in self._strokes:
            if start != pen:
                commands.append(f"M{start[0] * self._grid:.1f} {start[1] * self._grid:.1f}")
            commands.append(f"L{end[0] * self._grid:.1f} {end[1] * self._grid:.1f}")
            pen = end
        return "".join(commands)


def _halved(place: tuple[int, int]) -> tuple[int, int]:
    return round(place[0] / 2), round(place[1] / 2)


class _Thinned:
    """Lets through one mark of a kind in each cell of the map, where there are more marks than can be told apart."""

    def __init__(self, view: View, marks: int) -> None:
        self._cell = math.sqrt(view.width * view.height / _MOST) if marks > _MOST else 0.0
        self._taken: set[tuple[object, int, int]] = set()

    def lets(self, kind: object, x: float, y: float) -> bool:
        """Whether the mark is the first of its kind in its cell."""
        if not self._cell:
            return True
        cell = (kind, int(x / self._cell), int(y / self._cell))
        if cell in self._taken:
            return False
        self._taken.add(cell)
        return True


def _waypoints(record: Record, view: View) -> Iterator[Markup]:
    thinned = _Thinned(view, len(record.plan.waypoints_m))
    for index, place in enumerate(record.plan.waypoints_m):
        x, y = view.point(*place)
        if thinned.lets("waypoint", x, y):
            yield element(
                "circle", element("title", f"waypoint {index}"), cx=x, cy=y, r=1.6, class_="waypoint"
            )


def _home(view: View) -> Markup:
    x, y = view.point(0.0, 0.0)
    return element("path", element("title", "home"), d=f"M{x:.1f} {y - 9:.1f}l8 7v8h-16v-8z", class_="home")


def _calls(record: Record, places: Places, view: View) -> Iterator[Markup]:
    here: Position | None = None
    stacked = 0  # several calls at one place stand beside each other
    radius, thinned = _radius(record, view), _Thinned(view, len(record.calls))
    for call in record.calls:
        if call.position is None:
            continue
        stacked = stacked + 1 if call.position == here else 0
        here, result = call.position, call.result
        x, y = view.point(here.east_m, here.north_m)
        if thinned.lets((result.place, result.operation), x, y):
            about = element("title", in_short(call))
            yield places.mark(
                result.server, x + 2 * radius * stacked, y, radius, about, operation=result.operation
            )


def _radius(record: Record, view: View) -> float:
    """Of the calls' marks: smaller where many have to stand side by side."""
    if len(record.calls) <= MANY:
        return 4.0
    apart = math.sqrt(view.width * view.height / min(len(record.calls), _MOST))
    return min(4.0, 0.28 * apart)


def _turns(record: Record, view: View) -> Iterator[Markup]:
    turns = list(record.turns)
    thinned = _Thinned(view, len(turns))
    for waypoint, place in turns:
        x, y = view.point(place.east_m, place.north_m)
        if thinned.lets("turn", x, y):
            hook = f"M{x - 4:.1f} {y - 5:.1f}v-7a4 4 0 0 1 8 0v7m-3 -3l3 3l3 -3"
            yield element(
                "path", element("title", f"turned back to {named(waypoint)}"), d=hook, class_="turn"
            )


def _findings(findings: Sequence[Finding], view: View) -> Iterator[Markup]:
    """A number beside the place of each; those of one place, one behind the other."""
    beside: dict[tuple[float, float], int] = {}
    thinned = _Thinned(view, len(findings))
    for number, finding in enumerate(findings, start=1):
        x, y = place = view.point(finding.place.east_m, finding.place.north_m)
        about = element("title", f"finding {number}: {finding.words}")
        if number <= MOST_PICTURED:
            beside[place] = beside.get(place, -1) + 1
            yield _numbered(number, about, x + 9 + 16 * beside[place], y - 9)
        elif thinned.lets("finding", x, y):
            yield element("circle", about, cx=x, cy=y, r=5.5, class_="finding")


def _numbered(number: int, about: Markup, x: float, y: float) -> Markup:
    return element(
        "g",
        about,
        element("circle", cx=x, cy=y, r=7.5, class_="finding"),
        label(str(number), x, y + 3.5, style="number"),
    )


def _scale(view: View) -> Markup:
    metres = round_step(view.width * _SCALE_BAR / view.per_m / 2.5)
    y, long = view.height - 12, metres * view.per_m
    return joined(
        element("path", d=f"M{_MARGIN} {y - 4}v8M{_MARGIN} {y}h{long:.1f}m0 -4v8", class_="scale"),
        label(f"{metres:g} m", _MARGIN + long + 8, y + 4, anchor="start"),
    )
