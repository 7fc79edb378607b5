"""Positions and distances in metres around the mission's home.

The mission area is small, so upwash computes on a plane that touches the Earth (the WGS 84 ellipsoid) at home.
Degrees of latitude and longitude have the lengths that they have at home. Within 10 km of a home up to 60 degrees of
latitude the error stays below 0.1 % of the distance.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Generic, TypeAlias, TypeVar

import msgspec

MOST_PLACES = 5_000  # of a grid; what lies longest in the oldest square makes room
FARTHEST_M = 1e9  # from home, of any place: what comes from elsewhere is refused beyond it
Metres: TypeAlias = Annotated[float, msgspec.Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
_EQUATORIAL_RADIUS_M = 6_378_137.0  # WGS 84
_ECCENTRICITY_SQUARED = 6.694_379_990_141e-3


class Position(msgspec.Struct, frozen=True, gc=False):
    """A place relative to the mission's home: metres east and north of it, and above it."""

    east_m: Metres
    north_m: Metres
    altitude_m: Metres = 0.0

    def at_altitude(self, altitude_m: float) -> Position:
        """The same place over the ground, at that altitude above home."""
        return Position(self.east_m, self.north_m, altitude_m)


class Velocity(msgspec.Struct, frozen=True, gc=False):
    """A velocity in metres per second: eastwards, northwards and upwards."""

    east_m_s: float = 0.0
    north_m_s: float = 0.0
    up_m_s: float = 0.0

    @property
    def speed_m_s(self) -> float:
        """The speed along the flight path."""
        return math.hypot(self.east_m_s, self.north_m_s, self.up_m_s)

    @property
    def ground_m_s(self) -> float:
        """The ground speed: the horizontal part alone."""
        return math.hypot(self.east_m_s, self.north_m_s)


@dataclass(frozen=True, slots=True)
class GeoPosition:
    """A place on the Earth: latitude and longitude in degrees (WGS 84), altitude in metres above home."""

    latitude_deg: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    longitude_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)]
    altitude_m: Metres = 0.0


@dataclass(frozen=True, slots=True)
class EarthPosition:
    """A place on the Earth in degrees (WGS 84), its altitude above the sea, and the time there in seconds since 1970.

    Altitude and time are None where the vehicle does not report them.
    """

    latitude_deg: float
    longitude_deg: float
    above_sea_m: float | None = None
    unix_s: float | None = None


@dataclass(frozen=True, slots=True)
class Via:
    """A place without a photo on the way to a waypoint, where the drone comes to rest and hovers for `hold_s`.

    `ground_speed_m_s` is the speed of the way there, None for the current speed.
    """

    position: Position
    ground_speed_m_s: float | None = None
    hold_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place where the mission calls a service; `index` counts from 0 in flight order.

    `ground_speed_m_s` is the speed of the way there, None for the current speed. `above_sea_m` is its altitude in a
    plan that counts from the sea, which is sure only with home's altitude above the sea. The drone first hovers for
    `hold_s`. With a `row_end` the waypoint is a spot of a row, which the drone passes on its way there. On its way to
    the waypoint the drone flies to each place of `via`. A row that begins before its first spot has a `row_start`.
    """

    index: int
    position: Position
    ground_speed_m_s: float | None = None
    above_sea_m: float | None = None
    hold_s: float = 0.0
    row_end: Position | None = None
    row_start: Position | None = None
    via: tuple[Via, ...] = ()


@dataclass(frozen=True, slots=True)
class Circle:
    """An area on the ground: a server's radio range."""

    centre: Position
    radius_m: Annotated[float, msgspec.Meta(ge=0, le=FARTHEST_M)]

    def contains(self, position: Position) -> bool:
        """Whether the position lies within the circle, its border included."""
        return ground_distance_m(self.centre, position) <= self.radius_m

    def corners(self, sides: int) -> list[Position]:
        """The `sides` corners of a regular polygon on its border, anticlockwise from the east."""
        rays = [cmath.rect(self.radius_m, math.tau * side / sides) for side in range(sides)]
        return [Position(self.centre.east_m + ray.real, self.centre.north_m + ray.imag) for ray in rays]


@dataclass(frozen=True, slots=True)
class Measured:
    """The reach of a server without a radio range: it may answer everywhere, and calls measure how soon."""

    def contains(self, _position: Position) -> bool:
        """Always True, as nothing is known of a place before a call was made there."""
        return True


Reach: TypeAlias = Circle | Measured  # where a server is in range


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Converts between places on the Earth and positions relative to `home`."""

    home: GeoPosition

    def position(self, geo: GeoPosition) -> Position:
        """The position, relative to home, of a place on the Earth."""
        east_deg = math.remainder(geo.longitude_deg - self.home.longitude_deg, 360)
        north_deg = geo.latitude_deg - self.home.latitude_deg
        east_m, north_m = self.metres_per_degree()
        return Position(east_deg * east_m, north_deg * north_m, geo.altitude_m)

    def geo(self, position: Position) -> GeoPosition:
        """The place on the Earth of a position relative to home."""
        east_m, north_m = self.metres_per_degree()
        return GeoPosition(
            latitude_deg=self.home.latitude_deg + position.north_m / north_m,
            longitude_deg=math.remainder(self.home.longitude_deg + position.east_m / east_m, 360),
            altitude_m=position.altitude_m,
        )

    def metres_per_degree(self) -> tuple[float, float]:
        """The length in metres of one degree of longitude, and of one degree of latitude, at home."""
        latitude = math.radians(self.home.latitude_deg)
        flattening = 1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
        normal_m = _EQUATORIAL_RADIUS_M / math.sqrt(flattening)
        meridian_m = normal_m * (1 - _ECCENTRICITY_SQUARED) / flattening
        return math.radians(normal_m * math.cos(latitude)), math.radians(meridian_m)


def row_of(waypoint: Waypoint) -> tuple[Position | None, Position] | None:
    """What the spots of one row have in common; None of a place where the drone rests."""
    return None if waypoint.row_end is None else (waypoint.row_start, waypoint.row_end)


def first_on_way(waypoint: Waypoint) -> Via | Waypoint:
    """The first place on the way to the waypoint from the one before."""
    return waypoint.via[0] if waypoint.via else waypoint


def ground_way(start: Position, end: Position) -> complex:
    """The way over the ground from one place to another: metres east and north."""
    return complex(end.east_m - start.east_m, end.north_m - start.north_m)


def ground_distance_m(a: Position, b: Position) -> float:
    """Distance over the ground, without the altitudes."""
    return math.hypot(a.east_m - b.east_m, a.north_m - b.north_m)


def to_border_m(circle: Circle, place: Position) -> float:
    """Metres over the ground to the border of a circle."""
    return abs(ground_distance_m(circle.centre, place) - circle.radius_m)


def inside(circle: Circle, start: Position, end: Position) -> tuple[float, float] | None:
    """Where the line over two places is in a circle, from one share of their distance to another; None if nowhere.

    A share is below 0 before the start, and above 1 behind the end. It is infinite for a way straight up.
    """
    back, to_centre = ground_way(end, start), ground_way(end, circle.centre)
    if (ground_m := abs(back)) == 0:
        return (-math.inf, math.inf) if circle.contains(start) else None
    along_m = (back * to_centre.conjugate()).real / ground_m
    across_m2 = to_centre.real**2 + to_centre.imag**2 - along_m**2
    if across_m2 > circle.radius_m**2:
        return None
    half_m = math.sqrt(circle.radius_m**2 - across_m2)
    return 1 - (along_m + half_m) / ground_m, 1 - (along_m - half_m) / ground_m


def ahead(place: Position, velocity: Velocity, time_s: float) -> Position:
    """The position after `time_s` at that velocity, never below the ground."""
    return Position(
        place.east_m + velocity.east_m_s * time_s,
        place.north_m + velocity.north_m_s * time_s,
        max(0.0, place.altitude_m + velocity.up_m_s * time_s),
    )


def distance_m(a: Position, b: Position) -> float:
    """Straight distance, altitude included."""
    return math.hypot(a.east_m - b.east_m, a.north_m - b.north_m, a.altitude_m - b.altitude_m)


def part_way(start: Position, end: Position, share: float) -> Position:
    """The place on the straight way after that share of it."""
    return Position(
        start.east_m + share * (end.east_m - start.east_m),
        start.north_m + share * (end.north_m - start.north_m),
        start.altitude_m + share * (end.altitude_m - start.altitude_m),
    )


def nearest_share(place: Position, start: Position, end: Position) -> float:
    """Where the straight way is nearest to the place over the ground, as a share of it from 0 to 1."""
    way = ground_way(start, end)
    square = way.real**2 + way.imag**2
    ahead_m2 = (ground_way(start, place) * way.conjugate()).real
    return min(1.0, max(0.0, ahead_m2 / square)) if square else 0.0


def rounded(position: Position) -> Position:
    """The position, each coordinate rounded to the centimetre."""
    return Position(round(position.east_m, 2), round(position.north_m, 2), round(position.altitude_m, 2))


@dataclass(slots=True)
class Placed:
    """A place of a `Grid`."""

    position: Position


_Placed = TypeVar("_Placed", bound=Placed)


class Grid(Generic[_Placed]):
    """Places in squares, so that a search around a position reads few of them."""

    def __init__(self, places: Iterable[_Placed], *, side_m: float) -> None:
        self._side_m = side_m
        self._squares: dict[tuple[int, int], list[_Placed]] = {}
        self._count = 0
        for place in places:
            self.add(place)

    def __iter__(self) -> Iterator[_Placed]:
        return itertools.chain.from_iterable(self._squares.values())

    def add(self, place: _Placed) -> None:
        """Add a place; above `MOST_PLACES` the oldest place of a square is forgotten."""
        if self._count >= MOST_PLACES:
            oldest = next(iter(self._squares))
            self._squares[oldest].pop(0)
            self._count -= 1
            if not self._squares[oldest]:
                del self._squares[oldest]
        self._squares.setdefault(self._square(place.position), []).append(place)
        self._count += 1

    def around(self, position: Position, *, squares: int = 1) -> Iterator[_Placed]:
        """The places in the position's square and that many around it: one has all within `side_m`."""
        easts, norths = (range(at - squares, at + squares + 1) for at in self._square(position))
        for square in itertools.product(easts, norths):
            yield from self._squares.get(square, ())

    def _square(self, position: Position) -> tuple[int, int]:
        return math.floor(position.east_m / self._side_m), math.floor(position.north_m / self._side_m)
