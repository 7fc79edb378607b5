"""What figures have in common: axes, labels, and what they say to those who do not see them."""

from __future__ import annotations

import math
from collections.abc import Iterator

from upwash.report.markup import Markup, element

WIDTH, LEFT, RIGHT, TOP = 760.0, 48.0, 16.0, 16.0  # of a figure, and of its margins


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
