"""Fences: what lies in them, and which straight legs they allow."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position
from upwash.core.vehicle.geofence import (
    AreaUnion,
    Fence,
    Polygon,
    breached_by_leg,
    breached_by_move,
    breached_by_position,
    breached_by_way,
)

SQUARE = Polygon((Position(0, 0), Position(100, 0), Position(100, 100), Position(0, 100)))
# A U, open to the north: the notch lies between 40 and 60 m east, above 20 m north.
NOTCHED = Polygon(
    tuple(
        Position(east_m, north_m)
        for east_m, north_m in [
            (0, 0), (100, 0), (100, 100), (60, 100), (60, 20), (40, 20), (40, 100), (0, 100),
        ]
    )
)  # fmt: skip
DIAMOND = Polygon((Position(0, -50), Position(50, 0), Position(0, 50), Position(-50, 0)))
KITE = Polygon((Position(0, 0), Position(50, 50), Position(0, 100), Position(-50, 50)))
SOUTH_WEST = Polygon((Position(-100, -100), Position(0, -100), Position(0, 0), Position(-100, 0)))
DISC = Circle(Position(50, 50), 30)


def at(east_m: float, north_m: float) -> Position:
    return Position(east_m, north_m, 20.0)


@pytest.mark.parametrize(
    ("polygon", "place", "inside"),
    [
        (SQUARE, (50, 50), True),
        (SQUARE, (-1, 50), False),
        (SQUARE, (50, 101), False),
        (SQUARE, (100, 50), True),  # the border
        (SQUARE, (0, 0), True),  # a corner
        (SQUARE, (100.0005, 50), True),  # as good as on it
        (SQUARE, (100.01, 50), False),
        (SQUARE, (-0.001, 50), True),
        (SQUARE, (50, -0.001), True),
        (SOUTH_WEST, (0.001, -50), True),
        (SOUTH_WEST, (-50, 0.001), True),
        (DIAMOND, (10, 0), True),  # in line with two corners
        (DIAMOND, (60, 0), False),
        (DIAMOND, (-60, 0), False),
        (SQUARE, (200, 0), False),  # in line with a side
        (SQUARE, (-50, 100), False),
        (NOTCHED, (50, 60), False),
        (NOTCHED, (50, 10), True),
        (NOTCHED, (20, 20), True),  # in line with the floor of the notch
        (NOTCHED, (50, 20), True),
        (NOTCHED, (60, 60), True),
    ],
)
def test_what_lies_in_a_polygon(polygon: Polygon, place: tuple[float, float], inside: bool) -> None:
    assert polygon.contains(at(*place)) == inside


@pytest.mark.parametrize(
    ("area", "start", "end", "contained", "met"),
    [
        (SQUARE, (10, 10), (90, 90), True, True),
        (SQUARE, (10, 10), (110, 10), False, True),
        (SQUARE, (-10, 50), (110, 50), False, True),  # through all of it
        (SQUARE, (-10, 50), (-10, 90), False, False),
        (SQUARE, (0, 0), (100, 0), True, True),  # along the border
        (SQUARE, (-10, 0), (110, 0), False, True),  # along it, and beyond
        (SQUARE, (-50, 50), (50, -50), False, True),  # past a corner
        (SQUARE, (-50, 49), (49, -50), False, False),
        (SQUARE, (50, 50), (50, 50), True, True),  # hovering
        (SQUARE, (150, 50), (150, 50), False, False),
        (SQUARE, (100, 50), (100, 50), True, True),  # hovering above the border
        (SQUARE, (0, 0), (0, 0), True, True),  # and above a corner
        (KITE, (-10, -0.001), (10, -0.001), False, True),  # past its lowest corner
        (KITE, (-10, -0.0011), (10, -0.0011), False, False),
        (NOTCHED, (20, 90), (80, 90), False, True),  # over the notch
        (NOTCHED, (20, 10), (80, 10), True, True),
        (NOTCHED, (20, 20), (80, 20), True, True),  # along the floor of the notch
        (NOTCHED, (50, 90), (50, 30), False, False),  # within the notch
        (NOTCHED, (40, 90), (40, 30), True, True),  # along its side
        (DISC, (30, 50), (70, 50), True, True),
        (DISC, (0, 50), (100, 50), False, True),
        (DISC, (0, 85), (100, 85), False, False),
        (DISC, (0, 80), (100, 80), False, True),  # touches it
        (DISC, (30, 50), (30, 90), False, True),
    ],
)
def test_which_legs_lie_in_an_area(
    area: Polygon | Circle,
    start: tuple[float, float],
    end: tuple[float, float],
    contained: bool,
    met: bool,
) -> None:
    for one, other in ((at(*start), at(*end)), (at(*end), at(*start))):
        assert Fence("in", area, inclusion=True).allows_leg(one, other) == contained
        assert Fence("out", area, inclusion=False).allows_leg(one, other) == (not met)


def test_all_fences_have_to_allow_a_place() -> None:
    fences = (Fence("field", SQUARE, inclusion=True), Fence("house", DISC, inclusion=False))
    assert breached_by_position(fences, at(5, 5)) is None
    assert breached_by_position(fences, at(-5, 5)) == fences[0]
    assert breached_by_position(fences, at(50, 50)) == fences[1]
    assert breached_by_leg(fences, at(5, 5), at(95, 5)) is None
    assert breached_by_leg(fences, at(5, 5), at(95, 95)) == fences[1]


def test_a_vehicle_outside_may_come_back_in_and_one_inside_may_not_cut_a_corner() -> None:
    fences = (Fence("field", NOTCHED, inclusion=True),)
    assert breached_by_move(fences, at(20, 90), at(20, 50)) is None
    assert breached_by_move(fences, at(20, 90), at(80, 90)) == fences[0]
    assert breached_by_move(fences, at(50, 90), at(80, 90)) is None
    assert breached_by_move(fences, at(50, 90), at(50, 80)) == fences[0], "it would stay outside"


def test_each_leg_of_a_way_has_to_be_allowed() -> None:
    fences = (Fence("field", SQUARE, inclusion=True), Fence("house", DISC, inclusion=False))
    around = [at(5, 5), at(95, 5), at(95, 95)]
    assert breached_by_way(fences, around) is None
    assert breached_by_way(fences, [*around, at(5, 5)]) == fences[1]
    assert breached_by_way((), [*around, at(5, 5)]) is None


coordinates = st.integers(-20, 120).map(float)
places = st.builds(Position, coordinates, coordinates)


@given(start=places, end=places, polygon=st.sampled_from([SQUARE, NOTCHED]))
def test_a_leg_is_allowed_exactly_where_all_its_places_are(
    start: Position, end: Position, polygon: Polygon
) -> None:
    steps = [
        Position(
            start.east_m + share / 500 * (end.east_m - start.east_m),
            start.north_m + share / 500 * (end.north_m - start.north_m),
        )
        for share in range(501)
    ]
    inside = [polygon.contains(step) for step in steps]
    keeps_in, keeps_out = Fence("in", polygon, inclusion=True), Fence("out", polygon, inclusion=False)
    if keeps_in.allows_leg(start, end):
        assert all(inside)
    if keeps_out.allows_leg(start, end):
        assert not any(inside)
    if not any(inside):  # a corner may be cut between two steps
        missed_m = min(
            math.hypot(step.east_m - corner.east_m, step.north_m - corner.north_m)
            for step, corner in itertools.product(steps, polygon.corners)
        )
        assert keeps_out.allows_leg(start, end) or missed_m < 1.0


BESIDE = Polygon((Position(100, 0), Position(200, 0), Position(200, 100), Position(100, 100)))
APART = Polygon((Position(110, 0), Position(200, 0), Position(200, 100), Position(110, 100)))


@pytest.mark.parametrize(
    ("areas", "start", "end", "contained"),
    [
        ((SQUARE, BESIDE), (10, 50), (190, 50), True),  # over the border that they share
        ((SQUARE, BESIDE), (100, 10), (100, 90), True),  # along it
        ((SQUARE, BESIDE), (10, 50), (190, 150), False),
        ((SQUARE, APART), (10, 50), (190, 50), False),  # over the gap of 10 m
        ((SQUARE, APART, Circle(Position(105, 50), 10)), (10, 50), (190, 50), True),
        ((SQUARE, APART, Circle(Position(105, 50), 10)), (10, 58), (190, 58), True),
        ((SQUARE, APART, Circle(Position(105, 50), 10)), (10, 59.5), (190, 59.5), False),  # beside its chord
        ((Circle(Position(0, 0), 30), Circle(Position(40, 0), 30)), (-20, 0), (60, 0), True),
        ((Circle(Position(0, 0), 30), Circle(Position(70, 0), 30)), (-20, 0), (80, 0), False),
        ((SQUARE, BESIDE), (150, 50), (150, 50), True),  # hovering
        ((SQUARE, BESIDE), (250, 50), (250, 50), False),
        ((SQUARE, DISC), (50, 50), (50, 50), True),
        ((SQUARE, Circle(Position(150, 50), 50)), (99.5, 50), (100.5, 50), True),
    ],
)
def test_which_legs_keep_to_joined_areas(
    areas: tuple[Polygon | Circle, ...],
    start: tuple[float, float],
    end: tuple[float, float],
    contained: bool,
) -> None:
    joined = Fence("", AreaUnion(areas), inclusion=True)
    assert joined.allows_leg(at(*start), at(*end)) == contained
    assert joined.allows_leg(at(*end), at(*start)) == contained
    assert joined.allows(at(*start)) == any(area.contains(at(*start)) for area in areas)


@pytest.mark.parametrize(
    ("fence", "place", "clearance_m"),
    [
        (Fence("", SQUARE, True), (3, 50), 3.0),
        (Fence("", SQUARE, False), (104, 50), 4.0),
        (Fence("", DISC, True), (70, 50), 10.0),
        (Fence("", DISC, False), (90, 50), 10.0),
        (Fence("", AreaUnion((SQUARE, DISC)), True), (1, 50), 1.0),
        (Fence("", AreaUnion((SQUARE, DISC)), True), (50, 50), 50.0),
    ],
)
def test_how_far_a_place_is_from_what_a_fence_forbids(
    fence: Fence, place: tuple[float, float], clearance_m: float
) -> None:
    assert fence.clearance_m(at(*place)) == pytest.approx(clearance_m)
