"""Dot plots of many flights: a dot each, with the mean and what is sure of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from upwash.report.groups import Difference, Group, in_seconds
from upwash.report.markup import Markup, element, joined, svg
from upwash.support.confidence import Mean
from upwash.support.text import counted

_WIDTH, _LEFT, _RIGHT, _TOP = 760.0, 24.0, 16.0, 16.0  # of a figure, and of its margins
_SPARE = 0.06  # of the plot's breadth, either side of the dots
_MOST_TICKS = 7
_ROW, _NAME = 62.0, 16.0
_RADIUS = 4.0
_LANES = (0.0, -5.0, 5.0, -10.0, 10.0)  # in which dots lie, so that equal ones are seen side by side


def draw_times(groups: Sequence[Group]) -> Markup:
    """The mission time of each flight, a row a group, all in one scale."""
    times_s = [record.result.mission_time_s for group in groups for record in group.flights]
    x = _axis(times_s, [group.time_s for group in groups])
    bottom = _TOP + _ROW * len(groups)
    rows = []
    for number, group in enumerate(groups):
        name = f"{group.name}: {in_seconds(group.time_s)}, {counted(len(group.flights), 'flight')}"
        results = [(record.name, record.result.mission_time_s) for record in group.flights]
        dots = [(f"{flight}: {time_s:.1f} s", time_s) for flight, time_s in results]
        rows.append(_row(name, dots, group.time_s, x, _TOP + _ROW * number))
    told = "; ".join(f"{group.name}: {in_seconds(group.time_s)}" for group in groups)
    return _figure(
        "Mission time of each flight",
        f"On average, with 95 % confidence: {told}.",
        bottom + 40,
        *_scale(x, _TOP, bottom),
        *rows,
        _label("mission time (s)", _WIDTH / 2, bottom + 34, style="axis"),
    )


def draw_differences(differences: Sequence[Difference]) -> Markup:
    """How much longer the first of two policies took, a dot a pair; each row has a scale of its own, with 0 in it."""
    high = _ROW + 30
    rows = []
    for number, difference in enumerate(differences):
        top = _TOP + high * number
        longer_s = [pair.longer_s for pair in difference.pairs]
        x = _axis([0.0, *longer_s], [difference.longer_s])
        name = (
            f"{difference.policy} minus {difference.reference}: {in_seconds(difference.longer_s)}, "
            f"{counted(len(difference.pairs), 'pair')}"
        )
        dots = [(f"{pair.name}: {pair.longer_s:z.1f} s", pair.longer_s) for pair in difference.pairs]
        rows += [
            *_scale(x, top + _NAME, top + _ROW),
            element("line", x1=x(0), x2=x(0), y1=top + _NAME, y2=top + _ROW, class_="zero"),
            _row(name, dots, difference.longer_s, x, top),
        ]
    bottom = _TOP + high * len(differences)
    means = (f"{each.policy} minus {each.reference}: {in_seconds(each.longer_s)}" for each in differences)
    return _figure(
        "Differences within the same scenario and seed",
        f"On average, with 95 % confidence: {'; '.join(means)}.",
        bottom + 10,
        *rows,
        _label("difference of the mission times (s)", _WIDTH / 2, bottom + 2, style="axis"),
    )


def _axis(values: Sequence[float], means: Sequence[Mean]) -> _Axis:
    sure = [mean for mean in means if math.isfinite(mean.margin)]
    ends = [mean.value + sign * mean.margin for mean in sure for sign in (-1, 1)]
    least, most = min([*values, *ends]), max([*values, *ends])
    spare = _SPARE * (most - least) or 1.0
    return _Axis(least - spare, most + spare)


def _scale(x: _Axis, top: float, bottom: float) -> Iterator[Markup]:
    for value in x.ticks():
        yield joined(
            element("line", x1=x(value), x2=x(value), y1=top, y2=bottom, class_="grid"),
            _label(f"{value:g}", x(value), bottom + 16),
        )


def _row(name: str, dots: Sequence[tuple[str, float]], mean: Mean, x: _Axis, top: float) -> Markup:
    middle = top + _NAME + (_ROW - _NAME) / 2
    drawn = [
        element(
            "circle",
            element("title", told),
            cx=x(value), cy=middle + _LANES[number % len(_LANES)], r=_RADIUS, class_="dot",
        )
        for number, (told, value) in enumerate(dots)
    ]  # fmt: skip
    at = x(mean.value)
    sure = Markup()
    if math.isfinite(mean.margin):
        low, high = x(mean.value - mean.margin), x(mean.value + mean.margin)
        path = f"M{low:.1f} {middle - 6}v12M{low:.1f} {middle}H{high:.1f}M{high:.1f} {middle - 6}v12"
        sure = element("path", d=path, class_="sure")
    line = element(
        "line", element("title", f"mean: {in_seconds(mean)}"),
        x1=at, x2=at, y1=middle - 16, y2=middle + 16, class_="average",
    )  # fmt: skip
    return element("g", _label(name, _LEFT, top + 11, anchor="start", style="row halo"), *drawn, sure, line)


class _Axis:
    """Maps values from `first` to `last` onto the plot's breadth."""

    def __init__(self, first: float, last: float) -> None:
        self._first, self._last = first, last if last > first else first + 1

    def __call__(self, value: float) -> float:
        """Where the value is drawn."""
        return _LEFT + (value - self._first) / (self._last - self._first) * (_WIDTH - _RIGHT - _LEFT)

    def ticks(self) -> Iterator[float]:
        """Round values along it."""
        step = _round_step((self._last - self._first) / _MOST_TICKS)
        for number in range(math.ceil(self._first / step), math.floor(self._last / step) + 1):
            yield number * step


def _round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, ... (and their tenths, hundredths, ...) that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * factor for factor in (1, 2, 5, 10, 20) if power * factor >= least * 0.999)


def _figure(title: str, description: str, height: float, *content: Markup) -> Markup:
    """An SVG that says what it shows to those who do not see it."""
    said = element("title", title), element("desc", description)
    return svg(f"0 0 {_WIDTH:.0f} {height:.0f}", *said, *content)


def _label(text: str, x: float, y: float, *, anchor: str = "middle", style: str = "tick") -> Markup:
    return element("text", text, x=x, y=y, text_anchor=anchor, class_=style)
