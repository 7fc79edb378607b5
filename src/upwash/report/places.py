"""How calls look in every figure: where one ran has a colour and a shape, and what it ran is told by the fill."""

from __future__ import annotations

import math
from collections.abc import Sequence

from upwash.report.markup import Markup, element, joined
from upwash.report.palette import LIGHT

_SHAPES = (  # corners of the servers' marks, upwards from the right, on a circle of radius 1
    [(0.8, 0.8), (-0.8, 0.8), (-0.8, -0.8), (0.8, -0.8)],
    [(0.0, -1.1), (1.0, 0.75), (-1.0, 0.75)],
    [(0.0, -1.2), (1.0, 0.0), (0.0, 1.2), (-1.0, 0.0)],
    [(0.0, 1.1), (-1.0, -0.75), (1.0, -0.75)],
    [(math.sin(math.tau * turn / 5), -1.15 * math.cos(math.tau * turn / 5)) for turn in range(5)],
)


_FILLS = {
    "": "filled",
    "hollow": "hollow",
    "dotted": "with a dot",
}  # of operations in the order of their names


class Places:
    """The places where calls run, None for the drone, and what runs there, the same in all figures of a page."""

    def __init__(self, servers: Sequence[str], operations: Sequence[str] = ()) -> None:
        self._servers = list(servers)
        self._operations = list(operations)

    def colour(self, server: str | None) -> str:
        """The class that colours it."""
        if server is None:
            return "place-0"
        return f"place-{1 + self._servers.index(server) % (len(LIGHT.places) - 1)}"

    def mark(
        self, server: str | None, x: float, y: float, radius: float, *about: Markup, operation: str = ""
    ) -> Markup:
        """The mark of a call there, of that operation, with the centre at x, y."""
        fill = self._fill(operation)
        style = f"mark {self.colour(server)} {fill}".rstrip()
        if server is None:
            mark = element("circle", *about, cx=x, cy=y, r=radius, class_=style)
        else:
            shape = _SHAPES[self._servers.index(server) % len(_SHAPES)]
            corners = " ".join(f"{x + radius * right:.1f},{y + radius * down:.1f}" for right, down in shape)
            mark = element("polygon", *about, points=corners, class_=style)
        if fill != "dotted":
            return mark
        return joined(
            mark, element("circle", cx=x, cy=y, r=0.35 * radius, class_=f"dot {self.colour(server)}")
        )

    def _fill(self, operation: str) -> str:
        """The class that fills its marks."""
        number = self._operations.index(operation) if operation in self._operations else 0
        return list(_FILLS)[number % len(_FILLS)]

    def legend(self) -> Markup:
        """A line that names each mark, and how operations differ where there are several."""
        entries = [_entry(self.mark(place, 8, 8, 5), name_of(place)) for place in (None, *self._servers)]
        if len(self._operations) > 1:
            entries += [
                _entry(
                    self.mark(None, 8, 8, 5, operation=operation),
                    f"{_FILLS[self._fill(operation)]}: {operation}",
                )
                for operation in self._operations
            ]
        return element("p", *entries, class_="legend")


def _entry(mark: Markup, words: str) -> Markup:
    picture = element("svg", mark, viewBox="0 0 16 16", width=16, height=16, aria_hidden="true")
    return element("span", picture, words, class_="entry")


def name_of(server: str | None) -> str:
    """What people call the place: the server's name, or the drone."""
    return "drone" if server is None else server
