"""Places for the numbers of a map: beside their points, over no other number, and within the map."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

_CELL = 4.0  # of what is taken
_NEAREST, _FARTHEST, _STEP = 6.0, 150.0, 9.0  # from a point to its label's edge
_WAYS = 16  # around a point
_POINT = 6.0  # around it, which no label covers


class Spot(NamedTuple):
    """A place on the map."""

    x: float
    y: float


def place_labels(
    points: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    room: tuple[float, float],
    taken: Sequence[tuple[float, float, float, float]] = (),
) -> list[Spot | None]:
    """The middle of a label of each size for each point, None where there is no place for it.

    `room` is the map's width and height; `taken` has parts of it, left, top, right and bottom.
    """
    cells = {cell for x, y in points for cell in _cells(x - _POINT, y - _POINT, x + _POINT, y + _POINT)}
    cells.update(cell for box in taken for cell in _cells(*box))
    labels: list[Spot | None] = []
    for point, (width, height) in zip(points, sizes, strict=True):
        chosen = None
        for x, y in _around(point, width, height):
            box = x - width / 2, y - height / 2, x + width / 2, y + height / 2
            if box[0] < 0 or box[1] < 0 or box[2] > room[0] or box[3] > room[1]:
                continue
            own = set(_cells(*box))
            if own.isdisjoint(cells):
                cells |= own
                chosen = Spot(x, y)
                break
        labels.append(chosen)
    return labels


def _around(point: tuple[float, float], width: float, height: float) -> Iterator[tuple[float, float]]:
    """Where a label may have its middle, the nearest first, to the right and above before the other sides."""
    for ring in range(int((_FARTHEST - _NEAREST) / _STEP)):
        away = _NEAREST + ring * _STEP
        for way in range(_WAYS):
            angle = math.pi / 4 + way * 2 * math.pi / _WAYS
            right, up = math.cos(angle), math.sin(angle)
            yield point[0] + right * (away + width / 2), point[1] - up * (away + height / 2)


def _cells(left: float, top: float, right: float, bottom: float) -> Iterator[tuple[int, int]]:
    for column in range(math.floor(left / _CELL), math.ceil(right / _CELL)):
        for row in range(math.floor(top / _CELL), math.ceil(bottom / _CELL)):
            yield column, row
