"""Which order is taken, by how long the mission takes in each."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position, Waypoint, distance_m
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.planning.order import SWEEPS, Forecaster, Sweep, best_order, sweeps

GIVEN = [Waypoint(index, Position(20.0 * index, 0.0, 20.0)) for index in range(3)]
LOOK = Operation("detector", "process_photo", "heavy")
LEG_S, PHOTO_S, LOCAL_S, REMOTE_S, CHECK_S = 9.0, 1.0, 10.0, 0.5, 3.0  # 20 m at 4 m/s and 1 m/s²


def forecaster(*, stands: Position = GIVEN[0].position, **areas: Circle) -> Forecaster:
    there = Beliefs(check_s=CHECK_S, check_running_s=CHECK_S, remote_s={LOOK: REMOTE_S})
    return Forecaster(
        MissionBeliefs(GIVEN, 4.0, Pace(1.0), [StopCall(LOOK, PHOTO_S)]),
        Estimates(local_s={LOOK: LOCAL_S}, servers=dict.fromkeys(areas, there)),
        areas,
        gain_wait=0.25,
        stands=stands,
        home_s=lambda place: 16.0 + place.east_m,
    )


def test_the_forecast_has_the_way_out_and_home_every_leg_photo_and_call() -> None:
    calls_s = 3 * (PHOTO_S + LOCAL_S)
    assert forecaster().mission_s(GIVEN) == pytest.approx(2 * LEG_S + calls_s + 16 + 40)
    back = GIVEN[::-1]
    out_s = 40 / 4 + 4  # at 4 m/s and 1 m/s²
    assert forecaster().mission_s(back) == pytest.approx(out_s + 2 * LEG_S + calls_s + 16)


def test_the_forecast_has_calls_on_a_server_once_it_was_joined() -> None:
    last = forecaster(s1=Circle(Position(40.0, 0.0), 10.0))
    # Joined from half of the leg on, and through with it before the photo is taken.
    assert last.mission_s(GIVEN) == pytest.approx(2 * LEG_S + 3 * PHOTO_S + 2 * LOCAL_S + REMOTE_S + 16 + 40)


def taking(**times_s: float) -> tuple[str, list[int], int | None]:
    """What is taken where the given order takes 100 s and some sweeps less."""
    found = sweeps(GIVEN)
    by_order = {tuple(GIVEN): 100.0}
    for name, time_s in times_s.items():
        by_order[found[int(name.removeprefix("sweep_"))].waypoints] = time_s

    def mission_s(waypoints: Sequence[Waypoint]) -> float:
        return by_order.get(tuple(waypoints), 120.0)

    order = best_order(GIVEN, found, mission_s)
    return order.why, [waypoint.index for waypoint in order.waypoints], order.sweep


def test_a_sweep_is_taken_where_it_saves_two_per_cent_and_not_where_it_saves_less() -> None:
    why, indices, sweep = taking(sweep_1=98.0)
    assert (indices, sweep) == ([2, 1, 0], 1)
    assert why.startswith("sweep 1, by rows from the ")
    assert "saves 2.0 % by forecast (1:38 instead of 1:40)" in why
    assert "saves 55.0 % by forecast (0:45 instead of 1:40)" in taking(sweep_1=45.0)[0]
    why, indices, sweep = taking(sweep_1=100.0)
    assert (why, sweep) == ("as given: by forecast no sweep is quicker", None)
    why, indices, sweep = taking(sweep_1=98.1)
    assert (indices, sweep) == ([0, 1, 2], None)
    assert "less than 2 %" in why


def test_the_given_order_stays_where_no_sweep_is_quicker_or_allowed() -> None:
    assert taking() == ("as given: by forecast no sweep is quicker", [0, 1, 2], None)
    assert best_order(GIVEN, [], lambda _: 1.0).waypoints == tuple(GIVEN)


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
    return [(waypoint.position.east_m, waypoint.position.north_m) for waypoint in sweep.waypoints]


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


@pytest.mark.parametrize(("off_m", "count"), [(5.0, SWEEPS), (5.1, 0)])
def test_a_place_belongs_to_a_row_up_to_a_quarter_of_the_least_distance_off_it(
    off_m: float, count: int
) -> None:
    assert len(sweeps(waypoints([(0.0, 0.0), (20.0, 0.0), (40.0, off_m)]))) == count


def test_a_column_runs_north_though_its_places_are_the_nearest_to_each_other() -> None:
    given = [(0.0, 0.0), (0.0, 20.0), (30.0, 20.0), (30.0, 0.0)]
    assert sweeps(waypoints(given))[0].name == "by columns from the bottom-left"


def test_a_field_that_begins_in_the_middle_is_swept_from_the_bottom_left() -> None:
    for first in ((0.0, 20.0), (20.0, 0.0), (20.0, 20.0)):
        others = [place for place in field(3, 3) if place != first]
        assert sweeps(waypoints([first, *others]))[0].name.endswith("from the bottom-left")


def test_two_places_are_a_field() -> None:
    assert len(sweeps(waypoints([(0.0, 0.0), (20.0, 0.0)]))) == SWEEPS


def test_rows_and_columns_may_be_unevenly_far_apart() -> None:
    uneven = [(x, y) for y in (0.0, 20.0, 70.0) for x in (0.0, 10.0, 40.0)]
    assert len(sweeps(waypoints(uneven))) == SWEEPS
