"""The flight from above, as SVG: plan, way, ranges, and where the call at each waypoint ran."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.eventlog.narration import named
from upwash.report.charts import figure, in_short, label, round_step
from upwash.report.markup import Markup, element, joined
from upwash.report.places import Places
from upwash.report.record import Record

_SIDE, _MARGIN = 560.0, 28.0
_SCALE_BAR = 0.25  # of the width, at most


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
        return _MARGIN + (east_m - self.west_m) * self.per_m, _MARGIN + (self.north_m - north_m) * self.per_m


def view_of(records: Iterable[Record]) -> View:
    """Shows everything of all of them."""
    west_m = east_m = south_m = north_m = 0.0
    for record in records:
        for x_m, y_m in _corners(record):
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
    """The ranges, the plan and the way flown, home, and a mark for each call at its place."""
    return figure(
        f"Map of the flight, {record.name}",
        f"{len(record.plan.waypoints_m)} waypoints planned, {len(record.plan.ranges)} servers' ranges, "
        f"{len(record.calls)} calls; north is up.",
        view.width,
        view.height,
        *_ranges(record, places, view),
        _line(record.plan.way_m, view, "plan"),
        _line(((fix.position.east_m, fix.position.north_m) for fix in record.track), view, "track"),
        *_waypoints(record, view),
        _home(view),
        *_calls(record, places, view),
        *_turns(record, view),
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


def _names(record: Record, view: View) -> Iterator[Markup]:
    for name, area in record.plan.ranges.items():
        x, y = view.point(area.centre.east_m, area.centre.north_m)
        yield label(name, x, y - 9, style="row halo")


def _line(places_m: Iterable[tuple[float, float]], view: View, style: str) -> Markup:
    points = (view.point(east_m, north_m) for east_m, north_m in places_m)
    return element("polyline", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in points), class_=style)


def _waypoints(record: Record, view: View) -> Iterator[Markup]:
    for index, place in enumerate(record.plan.waypoints_m):
        x, y = view.point(*place)
        yield element("circle", element("title", f"waypoint {index}"), cx=x, cy=y, r=1.6, class_="waypoint")


def _home(view: View) -> Markup:
    x, y = view.point(0.0, 0.0)
    return element("path", element("title", "home"), d=f"M{x:.1f} {y - 9:.1f}l8 7v8h-16v-8z", class_="home")


def _calls(record: Record, places: Places, view: View) -> Iterator[Markup]:
    here: Position | None = None
    stacked = 0  # several calls at one place stand beside each other
    for call in record.calls:
        if call.position is None:
            continue
        stacked = stacked + 1 if call.position == here else 0
        here = call.position
        x, y = view.point(here.east_m, here.north_m)
        yield places.mark(call.result.server, x + 8 * stacked, y, 4, element("title", in_short(call)))


def _turns(record: Record, view: View) -> Iterator[Markup]:
    for waypoint, place in record.turns:
        x, y = view.point(place.east_m, place.north_m)
        hook = f"M{x - 4:.1f} {y - 5:.1f}v-7a4 4 0 0 1 8 0v7m-3 -3l3 3l3 -3"
        yield element("path", element("title", f"turned back to {named(waypoint)}"), d=hook, class_="turn")


def _scale(view: View) -> Markup:
    metres = round_step(view.width * _SCALE_BAR / view.per_m / 2.5)
    y, long = view.height - 12, metres * view.per_m
    return joined(
        element("path", d=f"M{_MARGIN} {y - 4}v8M{_MARGIN} {y}h{long:.1f}m0 -4v8", class_="scale"),
        label(f"{metres:g} m", _MARGIN + long + 8, y + 4, anchor="start"),
    )
