"""Lines and rings of longitude and latitude, cut where they cross 180 degrees of longitude (RFC 7946, 3.1.9).

A position is its longitude, its latitude, and other numbers that a cut interpolates too. Of two neighbours the
shorter way round the Earth counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import TypeAlias

Place: TypeAlias = Sequence[float]

_HALF_DEG, _ROUND_DEG = 180.0, 360.0
_DIGITS = 7


def cut_line(places: Sequence[Place]) -> list[list[Place]]:
    """The parts of the line, in their order; a cut is the end of one part and the beginning of the next."""
    parts: list[list[Place]] = []
    for start, end in pairwise(_unrolled(places)):
        cuts = [start, *_cuts(start, end), end]
        for ends in pairwise(cuts):
            shift_deg = -_turn((ends[0][0] + ends[1][0]) / 2) * _ROUND_DEG
            a, b = (_shifted(place, shift_deg) for place in ends)
            if parts and parts[-1][-1] == a:
                parts[-1].append(b)
            else:
                parts.append([a, b])
    return parts


def cut_ring(places: Sequence[Place]) -> list[list[Place]]:
    """The closed rings that a closed convex ring is cut into, one for each side of the cut."""
    ring = _unrolled(places)
    turns = sorted({_turn(place[0]) for place in ring})
    rings = []
    for turn in range(turns[0], turns[-1] + 1):
        middle_deg = turn * _ROUND_DEG
        part = _clipped(ring, middle_deg - _HALF_DEG, lambda deg, least_deg: deg >= least_deg)
        part = _clipped(part, middle_deg + _HALF_DEG, lambda deg, most_deg: deg <= most_deg)
        if len({place[0] for place in part}) > 1:  # else the ring only touches the cut
            closed = part if part[0] == part[-1] else [*part, part[0]]
            rings.append([_shifted(place, -middle_deg) for place in closed])
    return rings


def _turn(longitude_deg: float) -> int:
    """How often a longitude has gone round the Earth."""
    return round(longitude_deg / _ROUND_DEG)


def _unrolled(places: Sequence[Place]) -> list[Place]:
    """The places with longitudes that differ by less than 180 degrees from each to the next."""
    unrolled = [places[0]]
    for place in places[1:]:
        before_deg = unrolled[-1][0]
        unrolled.append((before_deg + math.remainder(place[0] - before_deg, _ROUND_DEG), *place[1:]))
    return unrolled


def _cuts(start: Place, end: Place) -> Iterator[Place]:
    """Where the way from one place to the next crosses 180 degrees, on any turn."""
    first, last = _turn(start[0]), _turn(end[0])
    step = 1 if last > first else -1
    for turn in range(first, last, step):
        yield _at(start, end, turn * _ROUND_DEG + step * _HALF_DEG)


def _at(start: Place, end: Place, longitude_deg: float) -> Place:
    share = (longitude_deg - start[0]) / (end[0] - start[0])
    rest = (a + share * (b - a) for a, b in zip(start[1:], end[1:], strict=True))
    return longitude_deg, *(round(each, _DIGITS) for each in rest)


def _shifted(place: Place, deg: float) -> Place:
    return round(place[0] + deg, _DIGITS), *place[1:]


def _clipped(
    ring: Sequence[Place], border_deg: float, is_inside: Callable[[float, float], bool]
) -> list[Place]:
    """The part of the ring on one side of a meridian."""
    clipped: list[Place] = []
    for start, end in zip(ring, [*ring[1:], *ring[:1]], strict=True):
        inside = is_inside(start[0], border_deg), is_inside(end[0], border_deg)
        if inside[0]:
            clipped.append(start)
        if inside[0] != inside[1]:
            clipped.append(_at(start, end, border_deg))
    return clipped
