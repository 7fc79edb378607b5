"""How the drone and each server look in every figure: a colour and a shape, so that neither is needed alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

from upwash.report.markup import Markup, element
from upwash.report.palette import LIGHT

_SHAPES = (  # corners of the servers' marks, upwards from the right, on a circle of radius 1
    [(0.8, 0.8), (-0.8, 0.8), (-0.8, -0.8), (0.8, -0.8)],
    [(0.0, -1.1), (1.0, 0.75), (-1.0, 0.75)],
    [(0.0, -1.2), (1.0, 0.0), (0.0, 1.2), (-1.0, 0.0)],
    [(0.0, 1.1), (-1.0, -0.75), (1.0, -0.75)],
    [(math.sin(math.tau * turn / 5), -1.15 * math.cos(math.tau * turn / 5)) for turn in range(5)],
)


class Places:
    """The places where calls run, None for the drone, the same in all figures of a page."""

    def __init__(self, servers: Sequence[str]) -> None:
        self._servers = list(servers)

    def colour(self, server: str | None) -> str:
        """The class that colours it."""
        if server is None:
            return "place-0"
        return f"place-{1 + self._servers.index(server) % (len(LIGHT.places) - 1)}"

    def mark(self, server: str | None, x: float, y: float, radius: float, *about: Markup) -> Markup:
        """Its mark with the centre at x, y."""
        style = f"mark {self.colour(server)}"
        if server is None:
            return element("circle", *about, cx=x, cy=y, r=radius, class_=style)
        shape = _SHAPES[self._servers.index(server) % len(_SHAPES)]
        corners = " ".join(f"{x + radius * right:.1f},{y + radius * down:.1f}" for right, down in shape)
        return element("polygon", *about, points=corners, class_=style)

    def legend(self) -> Markup:
        """A line that names each mark."""
        return element("p", *(self._entry(place) for place in (None, *self._servers)), class_="legend")

    def _entry(self, place: str | None) -> Markup:
        picture = element(
            "svg", self.mark(place, 8, 8, 5), viewBox="0 0 16 16", width=16, height=16, aria_hidden="true"
        )
        return element("span", picture, name_of(place), class_="entry")


def name_of(server: str | None) -> str:
    """What people call the place: the server's name, or the drone."""
    return "drone" if server is None else server
