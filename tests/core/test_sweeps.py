"""The eight sweeps of a field, and whether waypoints are one."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Position, Waypoint, distance_m
from upwash.core.planning.order import SWEEPS, Sweep, sweeps

SPACING_M = 20.0


def waypoints(places: Iterable[tuple[float, float]]) -> list[Waypoint]:
    return [
        Waypoint(index, Position(east_m, north_m, 20.0)) for index, (east_m, north_m) in enumerate(places)
    ]


def field(columns: int, rows: int) -> list[tuple[float, float]]:
    """Back and forth from the bottom-left."""
    return [
        ((column if row % 2 == 0 else columns - 1 - column) * SPACING_M, row * SPACING_M)
        for row in range(rows)
        for column in range(columns)
    ]


def turned(places: Iterable[tuple[float, float]], degrees: float) -> list[tuple[float, float]]:
    east, north = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return [(300 + x * east - y * north, -80 + x * north + y * east) for x, y in places]


def places(sweep: Sweep) -> list[tuple[float, float]]:
    return [(each.position.east_m, each.position.north_m) for each in sweep.waypoints]


def test_a_field_has_eight_sweeps_of_which_the_given_one_is_the_first() -> None:
    found = sweeps(waypoints(field(3, 2)))
    assert [each.number for each in found] == list(range(SWEEPS))
    assert [each.index for each in found[0].waypoints] == [0, 1, 2, 3, 4, 5]
    by_name = {each.name: [waypoint.index for waypoint in each.waypoints] for each in found}
    # 5 4 3   which lie
    # 0 1 2   like this
    assert by_name == {
        "by rows from the bottom-left": [0, 1, 2, 3, 4, 5],
        "by rows from the bottom-right": [2, 1, 0, 5, 4, 3],
        "by rows from the top-left": [5, 4, 3, 2, 1, 0],
        "by rows from the top-right": [3, 4, 5, 0, 1, 2],
        "by columns from the bottom-left": [0, 5, 4, 1, 2, 3],
        "by columns from the top-left": [5, 0, 1, 4, 3, 2],
        "by columns from the bottom-right": [2, 3, 4, 1, 0, 5],
        "by columns from the top-right": [3, 2, 1, 4, 5, 0],
    }


@given(
    columns=st.integers(1, 6),
    rows=st.integers(2, 6),
    degrees=st.floats(0, 360),
    seed=st.integers(0, 9),
    off_m=st.floats(0, 0.05),
)
def test_however_a_field_lies_and_is_ordered_each_sweep_visits_all_by_the_shortest_way(
    columns: int, rows: int, degrees: float, seed: int, off_m: float
) -> None:
    chance = random.Random(seed)
    lying = [
        (x + chance.uniform(-off_m, off_m), y + chance.uniform(-off_m, off_m))
        for x, y in turned(field(columns, rows), degrees)
    ]
    chance.shuffle(lying)
    mission = waypoints(lying)
    found = sweeps(mission)
    assert len(found) == SWEEPS
    for sweep in found:
        assert sorted(sweep.waypoints, key=lambda each: each.index) == mission
        legs = zip(sweep.waypoints, sweep.waypoints[1:], strict=False)
        assert all(distance_m(a.position, b.position) < SPACING_M + 4 * off_m + 1e-6 for a, b in legs)


@given(columns=st.integers(2, 5), rows=st.integers(2, 5), number=st.integers(0, SWEEPS - 1))
def test_whichever_sweep_is_given_is_the_first(columns: int, rows: int, number: int) -> None:
    as_given = places(sweeps(waypoints(field(columns, rows)))[number])
    assert places(sweeps(waypoints(as_given))[0]) == as_given


@pytest.mark.parametrize(
    "given_places",
    [
        [(0.0, 0.0)],
        [(0.0, 0.0), (0.0, 0.0)],
        field(3, 3)[:-1],
        [*field(3, 3), (0.0, 0.0)],
        [*field(3, 3), (90.0, 70.0)],
        [(0.0, 0.0), (50.0, 20.0), (120.0, 10.0), (180.0, 60.0)],
    ],
    ids=["one", "one twice", "one lacks", "one twice in a field", "one apart", "a crooked line"],
)
def test_what_is_no_full_grid_has_no_sweep(given_places: list[tuple[float, float]]) -> None:
    assert sweeps(waypoints(given_places)) == ()


def test_rows_and_columns_may_be_unevenly_far_apart() -> None:
    uneven = [(x, y) for y in (0.0, 20.0, 70.0) for x in (0.0, 10.0, 40.0)]
    assert len(sweeps(waypoints(uneven))) == SWEEPS
