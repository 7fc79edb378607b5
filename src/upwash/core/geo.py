"""Positions and distances in metres around the mission's home.

The mission area is small, so upwash computes on a plane that touches the Earth at home. One degree of
latitude is taken as a constant length, one of longitude as that times the cosine of home's latitude; within
10 km of home the error stays below 0.1 % of the distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_METRES_PER_DEGREE = 111_319.490_793  # 2 pi 6378137 / 360 (WGS 84 equatorial radius)


@dataclass(frozen=True, slots=True)
class Position:
    """A place relative to the mission's home: metres east and north of it, and above it."""

    east_m: float
    north_m: float
    altitude_m: float = 0.0


@dataclass(frozen=True, slots=True)
class GeoPosition:
    """A place on the Earth, in degrees, and metres above home."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place where the mission wants something done; `index` counts from 0 in flight order."""

    index: int
    position: Position


@dataclass(frozen=True, slots=True)
class Circle:
    """An area on the ground: a server's radio range."""

    centre: Position
    radius_m: float

    def contains(self, position: Position) -> bool:
        """Whether the position lies within the circle, its border included."""
        return ground_distance_m(self.centre, position) <= self.radius_m


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Converts between places on the Earth and positions relative to `home`."""

    home: GeoPosition

    def position(self, geo: GeoPosition) -> Position:
        """The position, relative to home, of a place on the Earth."""
        return Position(
            east_m=(geo.longitude_deg - self.home.longitude_deg) * self._metres_per_degree_east(),
            north_m=(geo.latitude_deg - self.home.latitude_deg) * _METRES_PER_DEGREE,
            altitude_m=geo.altitude_m,
        )

    def geo(self, position: Position) -> GeoPosition:
        """The place on the Earth of a position relative to home."""
        return GeoPosition(
            latitude_deg=self.home.latitude_deg + position.north_m / _METRES_PER_DEGREE,
            longitude_deg=self.home.longitude_deg + position.east_m / self._metres_per_degree_east(),
            altitude_m=position.altitude_m,
        )

    def _metres_per_degree_east(self) -> float:
        return _METRES_PER_DEGREE * math.cos(math.radians(self.home.latitude_deg))


def ground_distance_m(a: Position, b: Position) -> float:
    """Distance over the ground, whatever the altitudes."""
    return math.hypot(a.east_m - b.east_m, a.north_m - b.north_m)


def distance_m(a: Position, b: Position) -> float:
    """Straight distance, altitude included."""
    return math.hypot(a.east_m - b.east_m, a.north_m - b.north_m, a.altitude_m - b.altitude_m)
