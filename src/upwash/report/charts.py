"""Figures over waypoints and over time, as SVG."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from upwash.core import places as place_names
from upwash.core.servers import CHECKING, State
from upwash.eventlog.narration import counted, named, ran_on
from upwash.eventlog.results import mean_local_delay_s
from upwash.report.going import OpenAnswer
from upwash.report.markup import Markup, element, joined
from upwash.report.places import Places, name_of
from upwash.report.record import Record, ReportedCall, Stretch

_WIDTH, _LEFT, _RIGHT = 760.0, 48.0, 16.0
_TOP, _HEIGHT, _BOTTOM = 16.0, 260.0, 44.0
_ROW, _BAR = 34.0, 20.0
IDLE_HEIGHTS = {State.AVL: 3.0, State.AVL_R: 8.0}  # shape as well as colour: idle states are thin
_WIDE_ENOUGH_FOR_TEXT = 46.0
_NARROWEST = 0.5


class Axis:
    """Maps values from `first` to `last` onto the plane from `start` to `end`."""

    def __init__(self, first: float, last: float, start: float, end: float) -> None:
        self._first, self._last = first, last if last > first else first + 1
        self._start, self._end = start, end

    def __call__(self, value: float) -> float:
        """Where the value is drawn."""
        return self._start + (value - self._first) / (self._last - self._first) * (self._end - self._start)

    def ticks(self, at_most: int, *, whole: bool = False) -> Iterator[float]:
        """Round values along it."""
        step = round_step((self._last - self._first) / at_most)
        step = max(1.0, step) if whole else step
        for number in range(math.ceil(self._first / step), math.floor(self._last / step) + 1):
            yield number * step


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, ... (and their tenths, hundredths, ...) that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * factor for factor in (1, 2, 5, 10, 20) if power * factor >= least * 0.999)


def figure(title: str, description: str, width: float, height: float, *content: Markup) -> Markup:
    """An SVG that says what it shows to those who do not see it."""
    return element(
        "svg",
        element("title", title),
        element("desc", description),
        *content,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        role="img",
    )


def label(text: str, x: float, y: float, *, anchor: str = "middle", style: str = "tick") -> Markup:
    """Text at x, y."""
    return element("text", text, x=x, y=y, text_anchor=anchor, class_=style)


def draw_call_delays(record: Record, places: Places, *, longest_s: float, last_waypoint: int) -> Markup:
    """The delay of each call by waypoint; the part that was waited is drawn broad, with a ring around the mark."""
    before = any(call.result.waypoint is None for call in record.calls)
    x = Axis(-1.5 if before else -0.5, last_waypoint + 0.5, _LEFT, _WIDTH - _RIGHT)
    y = Axis(0, longest_s * 1.12, _TOP + _HEIGHT, _TOP)
    across = [
        joined(
            element("line", x1=_LEFT, x2=_WIDTH - _RIGHT, y1=y(value), y2=y(value), class_="grid"),
            label(f"{value:g}", _LEFT - 8, y(value) + 4, anchor="end"),
        )
        for value in y.ticks(6)
    ]
    along = [
        label(f"{value:g}", x(value), _TOP + _HEIGHT + 18) for value in x.ticks(12, whole=True) if value >= 0
    ]
    means = [
        element(
            "line",
            element("title", f"{operation} on the drone: {mean_s:.2f} s on average"),
            x1=_LEFT, x2=_WIDTH - _RIGHT, y1=y(mean_s), y2=y(mean_s), class_="mean",
        )
        for operation, mean_s in sorted(mean_local_delay_s(record.result.calls).items())
    ]  # fmt: skip
    radius = min(4.5, max(2.0, 300 / (last_waypoint + 1)))
    return figure(
        f"Call delay by waypoint, {record.name}",
        _delays_in_words(record),
        _WIDTH,
        _TOP + _HEIGHT + _BOTTOM,
        *across,
        *along,
        *means,
        *(_draw_call(call, places, x, y, radius) for call in record.calls),
        label("waypoint", (_LEFT + _WIDTH - _RIGHT) / 2, _TOP + _HEIGHT + 38, style="axis"),
        label("call delay (s)", 6, _TOP, anchor="start", style="axis"),
    )


def _draw_call(
    call: ReportedCall,
    places: Places,
    x: Callable[[float], float],
    y: Callable[[float], float],
    radius: float,
) -> Markup:
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
    return element("g", *parts, places.mark(result.server, at, top, radius, about))


def in_short(call: ReportedCall) -> str:
    """A call in a few words."""
    result = call.result
    where = "before the first waypoint" if result.waypoint is None else f"waypoint {result.waypoint}"
    waited = f", {result.waited_s:.2f} s of it waited" if call.wait else ""
    return f"{where}: {result.operation} {ran_on(result.server)}, {result.delay_s:.2f} s{waited}"


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


def draw_timeline(record: Record, places: Places, *, longest_s: float) -> Markup:
    """The states of each server over the mission, a row each, with the calls that ran there beneath."""
    left = _LEFT + 40
    x = Axis(0, longest_s, left, _WIDTH - _RIGHT)
    bottom = _TOP + _ROW * (len(record.servers) + bool(record.answers))
    rows: list[Markup] = []
    for row, server in enumerate(record.servers):
        top = _TOP + row * _ROW
        rows.append(label(server, left - 8, top + 15, anchor="end", style="row"))
        rows += [_draw_stretch(stretch, x, top) for stretch in record.stretches.get(server, ())]
        rows += [
            element(
                "line",
                x1=x(call.at_s), x2=x(call.at_s), y1=top + _BAR + 2, y2=top + _BAR + 7,
                class_=f"stem {places.colour(server)}",
            )
            for call in record.result.calls
            if call.server == server
        ]  # fmt: skip
    if record.answers:
        rows += _draw_answers(record.answers, x, bottom - _ROW, left)
    along = [
        joined(
            element("line", x1=x(value), x2=x(value), y1=_TOP, y2=bottom, class_="grid"),
            label(f"{value:g}", x(value), bottom + 16),
        )
        for value in x.ticks(8)
    ]
    return figure(
        f"States of the servers over the mission, {record.name}",
        _states_in_words(record),
        _WIDTH,
        bottom + 40,
        *along,
        *rows,
        label("seconds of the mission", (left + _WIDTH - _RIGHT) / 2, bottom + 34, style="axis"),
    )


def _draw_answers(
    answers: Sequence[OpenAnswer], x: Callable[[float], float], top: float, left: float
) -> Iterator[Markup]:
    """The times in which the drone had gone on, thin where it did not have to turn back."""
    yield label("gone on", left - 8, top + 15, anchor="end", style="row")
    for each in answers:
        height = 8.0 if each.turned_at is None else _BAR
        back = "" if each.turned_at is None else ", turned back"
        about = f"{named(each.waypoint)}: gone on from {each.from_s:.1f} to {each.to_s:.1f} s{back}"
        yield element(
            "rect", element("title", about), x=x(each.from_s), y=top + (_BAR - height) / 2,
            width=max(_NARROWEST, x(each.to_s) - x(each.from_s)), height=height, class_="state gone-on",
        )  # fmt: skip


def _draw_stretch(stretch: Stretch, x: Callable[[float], float], top: float) -> Markup:
    start, width = x(stretch.from_s), max(_NARROWEST, x(stretch.to_s) - x(stretch.from_s))
    why = f" ({stretch.why})" if stretch.why else ""
    about = element("title", f"{stretch.state} from {stretch.from_s:.1f} to {stretch.to_s:.1f} s{why}")
    height = IDLE_HEIGHTS.get(stretch.state, _BAR)
    bar = element(
        "rect", about, x=start, y=top + (_BAR - height) / 2, width=width, height=height,
        class_=f"state {state_style(stretch.state)}",
    )  # fmt: skip
    if stretch.state in IDLE_HEIGHTS or width < _WIDE_ENOUGH_FOR_TEXT + 4 * len(stretch.state):
        return bar
    return joined(bar, label(stretch.state, start + width / 2, top + 14, style="in-bar"))


def state_style(state: State) -> str:
    """The class that draws a state."""
    return "state-check" if state in CHECKING else f"state-{state.lower()}"


def state_seconds(stretches: Sequence[Stretch]) -> dict[State, float]:
    """How long the server was in each state."""
    seconds: dict[State, float] = dict.fromkeys(State, 0.0)
    for stretch in stretches:
        seconds[stretch.state] += stretch.to_s - stretch.from_s
    return seconds


def _states_in_words(record: Record) -> str:
    told = []
    for server, stretches in record.stretches.items():
        spent = ", ".join(
            f"{state} {seconds_s:.0f} s" for state, seconds_s in state_seconds(stretches).items() if seconds_s
        )
        told.append(f"{name_of(server)}: {spent}")
    if record.answers:
        told.append(f"gone on before {counted(len(record.answers), 'answer')}")
    return "; ".join(told) + "."
