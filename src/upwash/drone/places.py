"""The places that a drone flies to, and the straight legs between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from upwash.core.geo import Position, Waypoint, distance_m, part_way

Place = Waypoint | Position
Allows = Callable[[Position, Position], bool]  # whether no fence forbids the straight way
_BESIDE_M = 2.0  # by wind and GPS
_LATE_M, _LATE_S = 1.0, 0.5  # a spot that was passed by more, at the speed of the row, is flown back to
_NEAR_M = 4.0  # of a spot that counts: an arrival is promised within 5 m, and a report may be a metre off


def position_of(place: Place) -> Position:
    """The position of a waypoint, or the position given."""
    return place.position if isinstance(place, Waypoint) else place


def index_of(place: Place | None) -> int | None:
    """The index of a waypoint; None for a position."""
    return place.index if isinstance(place, Waypoint) else None


def lies_on(spot: Position, start: Position, end: Position) -> bool:
    """Whether a leg from the start to the end passes the spot."""
    length_m, from_start_m = distance_m(start, end), distance_m(start, spot)
    if length_m == 0:
        return from_start_m <= _BESIDE_M
    along_m = ahead_m(spot, start, start=start, end=end)
    beside_m = math.sqrt(max(0.0, from_start_m**2 - along_m**2))
    return beside_m <= _BESIDE_M and -_BESIDE_M <= along_m <= length_m + _BESIDE_M


def ahead_m(spot: Position, here: Position, *, start: Position, end: Position) -> float:
    """How far ahead the spot is from here, along the way from the start to the end; negative if it was passed."""
    return (
        (end.east_m - start.east_m) * (spot.east_m - here.east_m)
        + (end.north_m - start.north_m) * (spot.north_m - here.north_m)
        + (end.altitude_m - start.altitude_m) * (spot.altitude_m - here.altitude_m)
    ) / distance_m(start, end)


def is_missed(spot: Position, here: Position, *, start: Position, end: Position, speed_m_s: float) -> bool:
    """Whether a vehicle with this speed has passed a spot of a leg too far away, or is too far beyond it by now."""
    beyond_m = -ahead_m(spot, here, start=start, end=end)
    is_late = beyond_m > max(_LATE_M, _LATE_S * speed_m_s)
    return is_late or (beyond_m >= 0 and is_far(spot, here))


def is_far(spot: Position, here: Position) -> bool:
    """Whether the spot is too far from here to count as reached, altitude included."""
    return distance_m(here, spot) > _NEAR_M


def nearest_on(start: Position, end: Position, here: Position) -> Position:
    """The place of a leg that is nearest to here."""
    length_m = distance_m(start, end)
    if length_m == 0:
        return end
    left_m = ahead_m(end, here, start=start, end=end)
    return part_way(start, end, min(1.0, max(0.0, 1 - left_m / length_m)))


def turns_around(
    way: Sequence[Position], here: Position, target: Position, allows: Allows
) -> Iterator[Position]:
    """The turns of a plan's way over which a drone flies to the target, where a fence forbids the straight way."""
    if not way or allows(here, target):
        return
    places = [here, *_turns(way, here, target, allows), target]
    number = 0
    while not allows(places[number], target):
        ahead = range(len(places) - 2, number, -1)
        number = next((far for far in ahead if allows(places[number], places[far])), 0)
        if not number:
            return
        yield places[number]


def _turns(way: Sequence[Position], here: Position, target: Position, allows: Allows) -> Sequence[Position]:
    last = _leg_over(way, target)
    if last is None:
        return ()
    first = _leg_over(way, here)
    if first is not None:
        return way[last:first][::-1] if first > last else way[first:last]
    near = sorted(range(len(way)), key=lambda turn: distance_m(here, way[turn]))
    turn = next((turn for turn in near if allows(here, way[turn])), 0)
    return way[last : turn + 1][::-1] if turn >= last else way[turn:last]


def _leg_over(way: Sequence[Position], place: Position) -> int | None:
    legs = range(len(way) - 1, 0, -1)
    return next((leg for leg in legs if lies_on(place, way[leg - 1], way[leg])), None)
