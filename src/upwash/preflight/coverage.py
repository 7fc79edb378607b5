"""Which waypoints lie in whose range, and for how long the drone will be there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.lab.range_intervals import RangeInterval


class Coverage(Struct, frozen=True, kw_only=True):
    """One server as the mission meets it.

    `nearest_m` is how far it stands from the nearest waypoint, and `longest_stay_s` the longest time that the drone
    is in its range at a stretch when it computes everything itself, which is when it is slowest.
    """

    server: str
    range_m: float
    nearest_m: float
    waypoints: tuple[int, ...]
    longest_stay_s: float


def coverage(
    places: Sequence[Position],
    areas: Mapping[str, Circle],
    intervals: Sequence[RangeInterval],
    *,
    ended_s: float,
) -> tuple[Coverage, ...]:
    """What each server covers of a mission over at least one place, which had these intervals and ended then."""
    return tuple(
        Coverage(
            server=name,
            range_m=area.radius_m,
            nearest_m=min(ground_distance_m(area.centre, place) for place in places),
            waypoints=tuple(index for index, place in enumerate(places) if area.contains(place)),
            longest_stay_s=max(
                (min(each.to_s, ended_s) - each.from_s for each in intervals if each.server == name),
                default=0.0,
            ),
        )
        for name, area in areas.items()
    )


def uncovered(waypoints: int, covered: Sequence[Coverage]) -> tuple[int, ...]:
    """The waypoints out of every server's range."""
    return tuple(sorted(set(range(waypoints)).difference(*(each.waypoints for each in covered))))
