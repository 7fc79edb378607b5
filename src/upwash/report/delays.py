"""The chart of call delays by waypoint: a mark a call, and in a long flight a box for the calls of many waypoints."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from upwash.core import operation as place_names
from upwash.eventlog.narration import counted, ran_on
from upwash.eventlog.results import mean_local_delay_s
from upwash.report.axes import LEFT, RIGHT, TOP, WIDTH, Axis, figure, label
from upwash.report.markup import Markup, element, joined
from upwash.report.places import Places
from upwash.report.record import Record, ReportedCall

MANY = 300  # calls, above which they have no mark each
_HEIGHT, _BOTTOM = 260.0, 44.0
_BINS = 40
_ROOM_FOR_WAITS = 24.0
_BROADEST = 12.0  # of a box


def draw_call_delays(record: Record, places: Places, *, longest_s: float, last_waypoint: int) -> Markup:
    """The delays of the calls by waypoint, each by itself or, of many, by their quartiles."""
    y = Axis(0, longest_s * 1.12, TOP + _HEIGHT, TOP)
    if len(record.calls) > MANY:
        return _in_boxes(record, places, y, last_waypoint)
    before = any(call.result.waypoint is None for call in record.calls)
    x = Axis(-1.5 if before else -0.5, last_waypoint + 0.5, LEFT, WIDTH - RIGHT)
    radius = min(4.5, max(2.0, 300 / (last_waypoint + 1)))
    return _framed(record, x, y, [_draw_call(call, places, x, y, radius) for call in record.calls])


def _framed(record: Record, x: Axis, y: Axis, content: Sequence[Markup], *, beneath: float = 0.0) -> Markup:
    """The content with its axes; `beneath` is the room that it takes below the lowest delay."""
    across = [
        joined(
            element("line", x1=LEFT, x2=WIDTH - RIGHT, y1=y(value), y2=y(value), class_="grid"),
            label(f"{value:g}", LEFT - 8, y(value) + 4, anchor="end"),
        )
        for value in y.ticks(6)
    ]
    bottom = y(0) + beneath
    along = [label(f"{value:g}", x(value), bottom + 18) for value in x.ticks(12, whole=True) if value >= 0]
    means = [
        element(
            "line",
            element("title", f"{operation} on the drone: {mean_s:.2f} s on average"),
            x1=LEFT, x2=WIDTH - RIGHT, y1=y(mean_s), y2=y(mean_s), class_="mean",
        )
        for operation, mean_s in sorted(mean_local_delay_s(record.result.calls).items())
    ]  # fmt: skip
    return figure(
        f"Call delay by waypoint, {record.name}",
        _delays_in_words(record),
        WIDTH,
        bottom + _BOTTOM,
        *across,
        *along,
        *means,
        *content,
        label("waypoint", (LEFT + WIDTH - RIGHT) / 2, bottom + 38, style="axis"),
        label("call delay (s)", 6, TOP, anchor="start", style="axis"),
    )


def _delays_in_words(record: Record) -> str:
    delays: dict[str | None, list[float]] = {}
    for call in record.result.calls:
        delays.setdefault(call.server, []).append(call.delay_s)
    told = [
        f"{len(values)} {ran_on(server)}, "
        f"{min(values):.2f} to {max(values):.2f} s, {sum(values) / len(values):.2f} s on average"
        for server, values in sorted(delays.items(), key=lambda each: place_names.name_of(each[0]))
    ]
    return f"{len(record.calls)} calls: {'; '.join(told) or 'none'}."


def in_short(call: ReportedCall) -> str:
    """A call in a few words."""
    result = call.result
    where = "before the first waypoint" if result.waypoint is None else f"waypoint {result.waypoint}"
    waited = f", {result.waited_s:.2f} s of it waited" if call.wait else ""
    return f"{where}: {result.operation} {ran_on(result.server)}, {result.delay_s:.2f} s{waited}"


def _draw_call(call: ReportedCall, places: Places, x: Axis, y: Axis, radius: float) -> Markup:
    """A mark; the part that was waited is drawn broad, with a ring around the mark."""
    result = call.result
    at, top = x(-1 if result.waypoint is None else result.waypoint), y(result.delay_s)
    parts = [
        element("line", x1=at, x2=at, y1=y(0), y2=top, class_=f"stem {places.colour(result.server)}"),
    ]
    if call.wait:
        parts += [
            element("line", x1=at, x2=at, y1=y(0), y2=y(result.waited_s), class_="waited"),
            element("circle", cx=at, cy=top, r=radius + 3, class_="ring"),
        ]
    about = element("title", in_short(call))
    return element(
        "g", *parts, places.mark(result.server, at, top, radius, about, operation=result.operation)
    )


# --- many calls -----------------------------------------------------------------------------------------------


def waypoints_a_box(last_waypoint: int) -> int:
    """Of how many waypoints a box has the calls; one before the first waypoint counts as there."""
    return max(1, math.ceil((last_waypoint + 1) / _BINS))


@dataclass(frozen=True, slots=True)
class _Box:
    """The delays of the calls of one operation at one place, made at the waypoints of one bin."""

    where: str
    server: str | None
    operation: str
    delays_s: Sequence[float]

    @property
    def quartiles_s(self) -> tuple[float, float, float]:
        """What a quarter, a half and three quarters of them took at most."""
        if len(self.delays_s) == 1:
            return (self.delays_s[0],) * 3
        low, middle, high = statistics.quantiles(self.delays_s, n=4, method="inclusive")
        return low, middle, high


def _in_boxes(record: Record, places: Places, y: Axis, last_waypoint: int) -> Markup:
    size = waypoints_a_box(last_waypoint)
    x = Axis(-0.5, last_waypoint + 0.5, LEFT, WIDTH - RIGHT)
    drawn = []
    for number, boxes in sorted(_boxes(record, size).items()):
        start, end = x(number * size - 0.5), x(min((number + 1) * size - 1, last_waypoint) + 0.5)
        across = (end - start) / len(boxes)
        drawn += [
            _draw_box(box, places, y, start + (index + 0.5) * across, min(across, _BROADEST))
            for index, box in enumerate(boxes)
        ]
    waits = list(_draw_waits(record, x, y(0), size))
    return _framed(record, x, y, [*drawn, *waits], beneath=_ROOM_FOR_WAITS if waits else 0.0)


def _boxes(record: Record, size: int) -> Mapping[int, list[_Box]]:
    """By bin, in the order of the places' names."""
    delays: dict[tuple[int, str, str], list[float]] = defaultdict(list)
    for call in record.result.calls:
        delays[(call.waypoint or 0) // size, call.place, call.operation].append(call.delay_s)
    boxes: dict[int, list[_Box]] = defaultdict(list)
    for (number, place, operation), delays_s in sorted(delays.items()):
        boxes[number].append(_Box(_span(number, size), place_names.server_of(place), operation, delays_s))
    return boxes


def _span(number: int, size: int) -> str:
    return f"waypoint {number}" if size == 1 else f"waypoints {number * size}-{(number + 1) * size - 1}"


def _draw_box(box: _Box, places: Places, y: Axis, at: float, breadth: float) -> Markup:
    low_s, middle_s, high_s = box.quartiles_s
    least_s, most_s = min(box.delays_s), max(box.delays_s)
    about = element(
        "title",
        f"{box.where}: {counted(len(box.delays_s), 'call')} of {box.operation} {ran_on(box.server)}, "
        f"{middle_s:.2f} s in the middle, half of them {low_s:.2f} to {high_s:.2f} s, "
        f"all {least_s:.2f} to {most_s:.2f} s",
    )
    colour, half = places.colour(box.server), max(0.8, 0.45 * breadth)
    return element(
        "g",
        about,
        element("line", x1=at, x2=at, y1=y(least_s), y2=y(most_s), class_=f"extremes {colour}"),
        element(
            "rect", x=at - half, y=y(high_s), width=2 * half, height=max(0.5, y(low_s) - y(high_s)),
            class_=f"quartiles {colour}",
        ),
        places.mark(box.server, at, y(middle_s), min(3.5, half + 1.5), operation=box.operation),
    )  # fmt: skip


def _draw_waits(record: Record, x: Axis, bottom: float, size: int) -> Iterator[Markup]:
    """Beneath the axis a stroke for the waits of each bin, the longer the more there were."""
    waits: dict[int, list[float]] = defaultdict(list)
    for call in record.calls:
        if call.wait:
            waits[(call.result.waypoint or 0) // size].append(call.result.waited_s)
    if waits:
        yield label("waits", LEFT - 8, bottom + 20, anchor="end")
    for number, waited_s in sorted(waits.items()):
        at = x(number * size + (size - 1) / 2)
        told = f"{_span(number, size)}: {counted(len(waited_s), 'call')} waited, {sum(waited_s):.1f} s altogether"
        yield element(
            "line", element("title", told), x1=at, x2=at, y1=bottom + 10, y2=bottom + 12 + min(10, 2 * len(waited_s)),
            class_="waited",
        )  # fmt: skip
