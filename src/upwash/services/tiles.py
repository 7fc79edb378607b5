"""Tiles of a large photo: where they lie, and one box for an object that several views show.

A view is a tile or the whole photo. Boxes of two views are one object where the views agree on what both show:
the parts of the boxes there cover each other. So a tile's border may cut an object of any size, and no object has
two boxes of one view. Each side of the object's box is from the best box that is not cut there.

The whole photo is coarse. A small box of it, which some tile shows whole, is one object with a tile's box that covers
about half of it, or lies in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from heapq import nlargest
from typing import TYPE_CHECKING, NamedTuple

from upwash.services.darknet.heads import MOST_CANDIDATES
from upwash.services.detection import Box

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_TILES = 1000
OVERLAP = 0.2  # of a tile's side, at least
_MOST_SIGHTINGS = 4 * MOST_CANDIDATES
_LEAST_AGREEMENT = 0.45  # intersection over union, or over the smaller part
_BORDER = 0.05  # of a tile's side: a box that ends there may be cut


class View(NamedTuple):
    """A part of a photo, in its pixels."""

    left_px: int
    top_px: int
    right_px: int
    bottom_px: int


class TileBox(NamedTuple):
    """A box in pixels of the photo, with the view that shows it."""

    view: View
    box: Box
    score: float
    label: int  # the number of its class


def tiles_of(width_px: int, height_px: int, tile_px: tuple[int, int]) -> list[View]:
    """The tiles of a photo, of one size: at most `tile_px` (width, height)."""
    wide_px, high_px = min(width_px, tile_px[0]), min(height_px, tile_px[1])
    return [
        View(left_px, top_px, left_px + wide_px, top_px + high_px)
        for top_px in _starts(height_px, high_px)
        for left_px in _starts(width_px, wide_px)
    ]


def _starts(length_px: int, tile_px: int) -> list[int]:
    """Even steps from the first pixel to the last."""
    room_px, step_px = length_px - tile_px, max(1, int(tile_px * (1 - OVERLAP)))
    steps = -(-room_px // step_px)
    return [number * room_px // max(1, steps) for number in range(steps + 1)]


def merged(sightings: Iterable[TileBox], photo: View) -> list[TileBox]:
    """One sighting of each object, best first, at most MOST_CANDIDATES of the best; `photo` is the whole."""
    import numpy as np

    ranked = nlargest(_MOST_SIGHTINGS, sightings, key=lambda sighting: sighting.score)
    if not ranked:
        return []
    boxes = np.array([_corners(sighting.box) for sighting in ranked])
    views = np.array([sighting.view for sighting in ranked], float)
    labels = np.array([sighting.label for sighting in ranked])
    tile_px = (views[:, 2:] - views[:, :2]).min(axis=0)
    fits = (boxes[:, 2:] - boxes[:, :2] <= OVERLAP * tile_px).all(axis=1)
    coarse = fits & (views[:, 2:] - views[:, :2] > tile_px).any(axis=1)
    pairs: list[tuple[float, int, int]] = []
    for one in range(len(ranked)):
        rest = np.s_[one + 1 :]
        low, high = np.maximum(views[one, :2], views[rest, :2]), np.minimum(views[one, 2:], views[rest, 2:])
        lows = [np.maximum(corner, low) for corner in (boxes[one, :2], boxes[rest, :2])]
        highs = [np.minimum(corner, high) for corner in (boxes[one, 2:], boxes[rest, 2:])]
        mine, others = (_area(*corners) for corners in zip(lows, highs, strict=True))
        shared = _area(np.maximum(*lows), np.minimum(*highs))
        either = mine + others - shared
        agree = shared > _LEAST_AGREEMENT * either
        agree |= (coarse[one] | coarse[rest]) & (shared > _LEAST_AGREEMENT * np.minimum(mine, others))
        agree &= (labels[rest] == labels[one]) & (views[rest] != views[one]).any(axis=1)
        pairs += (
            (float(shared[other] / either[other]), one, one + 1 + int(other))
            for other in np.flatnonzero(agree)
        )
    groups = [[number] for number in range(len(ranked))]
    for _, one, another in sorted(pairs, key=lambda pair: -pair[0]):
        into, out = groups[one], groups[another]
        if {ranked[number].view for number in into}.isdisjoint(ranked[number].view for number in out):
            into += out
            for number in out:
                groups[number] = into
    firsts = [group for number, group in enumerate(groups) if number == min(group)]
    return [
        _one_of(
            [ranked[number] for number in sorted(group, key=lambda number: (coarse[number], number))], photo
        )
        for group in firsts[:MOST_CANDIDATES]
    ]


def _area(low: Floats, high: Floats) -> Floats:
    import numpy as np

    area: Floats = np.maximum(high - low, 0).prod(axis=1)
    return area


def _one_of(group: Sequence[TileBox], photo: View) -> TileBox:
    """The best score, and each side from the first view of those that show it farthest from a border of theirs."""

    def how_well(sighting: TileBox, side: int) -> float:
        view = sighting.view
        length_px = view[side % 2 + 2] - view[side % 2]
        inside = abs(_corners(sighting.box)[side] - view[side]) / length_px
        return 1.0 if view[side] == photo[side] else min(1.0, inside / _BORDER)

    left, top, right, bottom = (
        _corners(max(group, key=lambda sighting: how_well(sighting, side)).box)[side] for side in range(4)
    )
    box = Box(left_px=left, top_px=top, width_px=right - left, height_px=bottom - top)
    return max(group, key=lambda sighting: sighting.score)._replace(box=box)


def _corners(box: Box) -> tuple[float, float, float, float]:
    return box.left_px, box.top_px, box.left_px + box.width_px, box.top_px + box.height_px
