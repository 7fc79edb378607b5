"""What is known of a mission's waypoints: which servers cover them, and how far home is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.core.geo import Circle, Position, Reach, ground_distance_m
from upwash.core.knowledge import coverage as measured
from upwash.core.vehicle.way_home import ARDUCOPTER, UNKNOWN, WayHome, descent_s, time_home_s
from upwash.lab.observer import RangeInterval


class ServerCoverage(Struct, frozen=True, kw_only=True):
    """One server as the mission meets it.

    `nearest_m` is its distance to the nearest waypoint. `longest_stay_s` is the longest time in its range at a
    stretch if the drone computes every call itself, which makes it slowest. Without a range, `range_m` and
    `nearest_m` are None; the server was `measured` at some waypoints, and covers all except those with mostly no
    answer.
    """

    server: str
    range_m: float | None
    nearest_m: float | None
    waypoints: tuple[int, ...]
    longest_stay_s: float
    measured: tuple[int, ...] = ()


def coverage(
    places: Sequence[Position],
    areas: Mapping[str, Reach],
    intervals: Sequence[RangeInterval],
    *,
    ended_s: float,
    known: measured.Coverage | None = None,
) -> tuple[ServerCoverage, ...]:
    """What each server covers of a mission over at least one place, which had these intervals and ended then."""
    return tuple(
        ServerCoverage(
            server=name,
            **_reach(name, area, places, known),
            longest_stay_s=max(
                (min(stay.to_s, ended_s) - stay.from_s for stay in intervals if stay.server == name),
                default=0.0,
            ),
        )
        for name, area in areas.items()
    )


def _reach(
    name: str, area: Reach, places: Sequence[Position], known: measured.Coverage | None
) -> dict[str, Any]:
    """The reach of the server, by its range or by measurements."""
    if isinstance(area, Circle):
        return {
            "range_m": area.radius_m,
            "nearest_m": min(ground_distance_m(area.centre, place) for place in places),
            "waypoints": tuple(index for index, place in enumerate(places) if area.contains(place)),
        }
    assert known is not None  # noqa: S101 - a server without a range has a map
    found = [known.at(name, place) for place in places]
    return {
        "range_m": None,
        "nearest_m": None,
        "waypoints": tuple(index for index, place in enumerate(found) if place is None or place.reached),
        "measured": tuple(index for index, place in enumerate(found) if place is not None),
    }


def uncovered(waypoints: int, covered: Sequence[ServerCoverage]) -> tuple[int, ...]:
    """The waypoints out of every server's range."""
    return tuple(sorted(set(range(waypoints)).difference(*(server.waypoints for server in covered))))


_HOME = Position(0.0, 0.0)
PX4_LOW_PERCENT = 15.0  # BAT_LOW_THR as a PX4 is delivered


class Farthest(Struct, frozen=True, kw_only=True):
    """The waypoint with the longest way home, without wind; the way down with `on_failure = "land"`.

    `out_s` is the least time there from the ground, and `needed_percent` the share of the battery for the way home;
    None if the file does not say how long the battery lasts.
    """

    waypoint: int
    away_m: float
    out_s: float
    home_s: float
    needed_percent: float | None


def farthest(config: DroneConfig) -> Farthest:
    """Of all waypoints of the plan."""
    way = ARDUCOPTER if config.vehicle.profile == "arducopter" else UNKNOWN
    _, found = max(
        ((_down_s(waypoint.position, config, way), waypoint) for waypoint in waypoints(config.mission)),
        key=lambda pair: pair[0],
    )
    home_s, endurance_s = _down_s(found.position, config, way), config.vehicle.endurance_s
    away_m = ground_distance_m(found.position, _HOME)
    climb_s = found.position.altitude_m / way.climb_m_s
    return Farthest(
        waypoint=found.index,
        away_m=away_m,
        out_s=climb_s + away_m / (found.ground_speed_m_s or config.mission.ground_speed_m_s),
        home_s=home_s,
        needed_percent=100 * home_s / endurance_s if endurance_s else None,
    )


def _down_s(place: Position, config: DroneConfig, way: WayHome) -> float:
    if config.autopilot.on_failure == "land":
        return way.hover_s + descent_s(place.altitude_m, way)
    return time_home_s(place, _HOME, way)
