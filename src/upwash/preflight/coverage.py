"""Which waypoints lie in whose range, and for how long the drone will be there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import Struct

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.core.knowledge import coverage as measured
from upwash.lab.range_intervals import RangeInterval


class Coverage(Struct, frozen=True, kw_only=True):
    """One server as the mission meets it.

    `nearest_m` is how far it stands from the nearest waypoint, and `longest_stay_s` the longest time that the drone
    is in its range at a stretch when it computes everything itself, which is when it is slowest. A server without a
    range, for which `range_m` and `nearest_m` are None, has been `measured` at some waypoints, and covers all but
    those of them where it mostly did not answer.
    """

    server: str
    range_m: float | None
    nearest_m: float | None
    waypoints: tuple[int, ...]
    longest_stay_s: float
    measured: tuple[int, ...] = ()


def coverage(
    places: Sequence[Position],
    areas: Mapping[str, Circle],
    intervals: Sequence[RangeInterval],
    *,
    ended_s: float,
    known: measured.Coverage | None = None,
) -> tuple[Coverage, ...]:
    """What each server covers of a mission over at least one place, which had these intervals and ended then."""
    return tuple(
        Coverage(
            server=name,
            **_reach(name, area, places, known),
            longest_stay_s=max(
                (min(each.to_s, ended_s) - each.from_s for each in intervals if each.server == name),
                default=0.0,
            ),
        )
        for name, area in areas.items()
    )


def _reach(
    name: str, area: Circle, places: Sequence[Position], known: measured.Coverage | None
) -> dict[str, Any]:
    """Where the server is in reach: by its range, or else by what was measured."""
    if known is None or name not in known.servers:
        return {
            "range_m": area.radius_m,
            "nearest_m": min(ground_distance_m(area.centre, place) for place in places),
            "waypoints": tuple(index for index, place in enumerate(places) if area.contains(place)),
        }
    found = [known.at(name, place) for place in places]
    return {
        "range_m": None,
        "nearest_m": None,
        "waypoints": tuple(index for index, each in enumerate(found) if each is None or each.reached),
        "measured": tuple(index for index, each in enumerate(found) if each is not None),
    }


def uncovered(waypoints: int, covered: Sequence[Coverage]) -> tuple[int, ...]:
    """The waypoints out of every server's range."""
    return tuple(sorted(set(range(waypoints)).difference(*(each.waypoints for each in covered))))
