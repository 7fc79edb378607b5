"""Which areas are around a place, found without looking at each."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.core.knowledge.ranges import AreaIndex

metres = st.floats(-5_000.0, 5_000.0)
places = st.builds(Position, metres, metres)
areas = st.lists(
    st.builds(Circle, places, st.one_of(st.just(math.inf), st.floats(0.0, 3_000.0))), max_size=30
)


@given(areas, places, st.one_of(st.just(0.0), st.floats(0.0, 10_000.0)))
def test_no_area_that_reaches_so_near_is_left_out(
    areas: list[Circle], place: Position, within_m: float
) -> None:
    near = AreaIndex(areas).near(place, within_m)
    reaching = [
        number
        for number, area in enumerate(areas)
        if ground_distance_m(place, area.centre) <= area.radius_m + within_m
    ]
    assert set(reaching) <= set(near)
    assert near == sorted(set(near))


def test_of_a_line_of_servers_few_are_looked_at() -> None:
    line = [Circle(Position(150.0 * number, 0.0), 100.0) for number in range(1_000)]
    near = AreaIndex(line).near(Position(75_000.0, 20.0), within_m=20.0)
    assert 500 in near
    assert len(near) < 5
