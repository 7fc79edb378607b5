from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import (
    Circle,
    GeoPosition,
    LocalFrame,
    Measured,
    Position,
    Velocity,
    ahead,
    distance_m,
    ground_distance_m,
    rounded,
)

HOME = GeoPosition(latitude_deg=39.3666, longitude_deg=22.9507)


def test_ground_distance_leaves_out_the_altitude() -> None:
    a, b = Position(1.0, 2.0, 0.0), Position(4.0, 6.0, 12.0)
    assert ground_distance_m(a, b) == 5.0
    assert distance_m(a, b) == 13.0


@pytest.mark.parametrize(
    ("position", "inside"),
    [
        (Position(80.0, 80.0), True),
        (Position(180.0, 80.0), True),  # on the border
        (Position(math.nextafter(180.0, math.inf), 80.0), False),
        (Position(151.0, 151.0), False),  # in the square around the circle, not in the circle
        (Position(80.0, 80.0, altitude_m=5000.0), True),  # an area on the ground
    ],
)
def test_a_circle_contains_its_border_and_any_altitude(position: Position, *, inside: bool) -> None:
    assert Circle(Position(80.0, 80.0), radius_m=100.0).contains(position) is inside


def test_the_corners_of_a_circle_lie_on_its_border_anticlockwise_from_the_east() -> None:
    corners = Circle(Position(10.0, 20.0), radius_m=5.0).corners(4)
    places = [(corner.east_m, corner.north_m) for corner in corners]
    assert places == [
        pytest.approx(place) for place in [(15.0, 20.0), (10.0, 25.0), (5.0, 20.0), (10.0, 15.0)]
    ]


def test_a_reach_that_is_measured_is_everywhere() -> None:
    assert Measured().contains(Position(1e6, -1e6))


@pytest.mark.parametrize(("time_s", "altitude_m"), [(0.0, 10.0), (2.0, 4.0), (5.0, 0.0)])
def test_the_place_ahead_is_never_below_the_ground(time_s: float, altitude_m: float) -> None:
    place = ahead(Position(1.0, 2.0, 10.0), Velocity(4.0, 0.5, -3.0), time_s)
    assert place == Position(1.0 + 4.0 * time_s, 2.0 + 0.5 * time_s, altitude_m)


def test_a_rounded_position_has_centimetres() -> None:
    assert rounded(Position(1.2345, -1.2375, 20.1251)) == Position(1.23, -1.24, 20.13)


def test_a_speed_is_that_along_the_path_or_over_the_ground() -> None:
    velocity = Velocity(3.0, 4.0, -12.0)
    assert (velocity.ground_m_s, velocity.speed_m_s) == (5.0, 13.0)


def test_a_plane_around_the_date_line_has_no_gap() -> None:
    frame = LocalFrame(GeoPosition(0.0, 179.9995))
    across = GeoPosition(0.0, -179.9995)
    assert frame.position(across).east_m == pytest.approx(111.32, abs=0.01)
    assert frame.geo(frame.position(across)).longitude_deg == pytest.approx(across.longitude_deg)


def test_home_is_the_origin() -> None:
    assert LocalFrame(HOME).position(HOME) == Position(0.0, 0.0, 0.0)


def test_east_is_positive_to_the_east_and_north_to_the_north() -> None:
    frame = LocalFrame(HOME)
    east = frame.position(GeoPosition(HOME.latitude_deg, HOME.longitude_deg + 0.001))
    north = frame.position(GeoPosition(HOME.latitude_deg + 0.001, HOME.longitude_deg, 20.0))
    assert east.east_m == pytest.approx(86.1, abs=0.2)
    assert east.north_m == 0.0
    assert north.north_m == pytest.approx(111.2, abs=0.3)
    assert north.east_m == 0.0
    assert north.altitude_m == 20.0


@given(
    latitude_deg=st.floats(-75.0, 75.0),
    longitude_deg=st.floats(-179.0, 179.0),
    east_m=st.floats(-10_000.0, 10_000.0),
    north_m=st.floats(-10_000.0, 10_000.0),
    altitude_m=st.floats(-100.0, 5_000.0),
)
def test_a_position_survives_the_way_to_the_earth_and_back(
    latitude_deg: float, longitude_deg: float, east_m: float, north_m: float, altitude_m: float
) -> None:
    frame = LocalFrame(GeoPosition(latitude_deg, longitude_deg))
    position = Position(east_m, north_m, altitude_m)
    again = frame.position(frame.geo(position))
    assert distance_m(position, again) < 1e-4


def test_the_plane_is_within_a_thousandth_of_the_earth() -> None:
    worst = 0.0
    for latitude_deg, bearing_deg in itertools.product((0.0, 39.3666, -39.3666, 60.0), range(0, 360, 15)):
        home, bearing = GeoPosition(latitude_deg, 22.9507), math.radians(bearing_deg)
        position = Position(9_900.0 * math.sin(bearing), 9_900.0 * math.cos(bearing))
        on_earth_m = math.dist(_ecef_m(home), _ecef_m(LocalFrame(home).geo(position)))
        worst = max(worst, abs(on_earth_m / 9_900.0 - 1))
    assert worst < 0.001


def _ecef_m(place: GeoPosition) -> tuple[float, float, float]:
    """Earth-centred coordinates on the WGS 84 ellipsoid; over 10 km a chord is 1 mm shorter than its arc."""
    radius_m, eccentricity_squared = 6_378_137.0, 6.694_379_990_14e-3
    latitude, longitude = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    normal_m = radius_m / math.sqrt(1 - eccentricity_squared * math.sin(latitude) ** 2)
    return (
        normal_m * math.cos(latitude) * math.cos(longitude),
        normal_m * math.cos(latitude) * math.sin(longitude),
        normal_m * (1 - eccentricity_squared) * math.sin(latitude),
    )
