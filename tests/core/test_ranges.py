"""Which ranges a place is in, found without looking at each range."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Measured, Position, Reach, ground_distance_m
from upwash.core.knowledge.ranges import AreaIndex, Ranges

metres = st.floats(-500, 500)
places = st.builds(Position, metres, metres)
near_steps = st.floats(-3, 3)


@given(
    st.lists(st.builds(Circle, places, st.floats(0.1, 300)), min_size=1, max_size=12),
    st.lists(st.tuples(near_steps, near_steps), max_size=80),
    places,
    places,
)
def test_every_border_is_noticed_on_a_long_way_of_small_steps_and_after_a_leap(
    circles: list[Circle], steps: list[tuple[float, float]], start: Position, leap: Position
) -> None:
    areas = {str(number): circle for number, circle in enumerate(circles)}
    ranges = Ranges(areas)
    inside: set[str] = set()
    way = [start]
    for east_m, north_m in steps:
        way.append(Position(way[-1].east_m + east_m, way[-1].north_m + north_m))
    for position in [*way, leap, leap, start]:
        inside ^= set(ranges.crossed(position))
        assert inside == {name for name, area in areas.items() if area.contains(position)}


def test_a_border_is_noticed_where_the_way_ends_exactly_on_it() -> None:
    ranges = Ranges({"s1": Circle(Position(100.0, 0.0), 50.0)})
    assert ranges.crossed(Position(0.0, 0.0)) == []
    assert ranges.crossed(Position(50.0, 0.0)) == ["s1"]


def test_a_place_is_on_a_border_within_a_centimetre() -> None:
    for east_m, is_on_border in (
        (49.5, False),
        (49.98, False),
        (49.995, True),
        (50.005, True),
        (50.1, False),
    ):
        ranges = Ranges({"far": Circle(Position(900.0, 0.0), 50.0), "s1": Circle(Position(100.0, 0.0), 50.0)})
        ranges.crossed(Position(east_m, 0.0))
        assert ranges.is_on_border == is_on_border
    assert not Ranges({}).is_on_border


class Counted(dict[str, Circle]):
    """Areas that count how often one of them is looked at."""

    looks = 0

    def __getitem__(self, name: str) -> Circle:
        self.looks += 1
        return super().__getitem__(name)


def test_far_areas_are_not_looked_at_again_and_again() -> None:
    areas = Counted({str(number): Circle(Position(5000, 10.0 * number), 100) for number in range(100)})
    ranges = Ranges(areas)
    for step in range(1000):
        ranges.crossed(Position(float(step), 0))
    assert areas.looks == 100


metres = st.floats(-5_000.0, 5_000.0)
places = st.builds(Position, metres, metres)
areas = st.lists(
    st.one_of(st.just(Measured()), st.builds(Circle, places, st.floats(0.0, 3_000.0))), max_size=30
)


@given(areas, places, st.one_of(st.just(0.0), st.floats(0.0, 10_000.0)))
def test_no_area_that_reaches_so_near_is_left_out(
    areas: list[Reach], place: Position, within_m: float
) -> None:
    near = AreaIndex(areas).near(place, within_m)
    reaching = [
        number
        for number, area in enumerate(areas)
        if isinstance(area, Measured) or ground_distance_m(place, area.centre) <= area.radius_m + within_m
    ]
    assert set(reaching) <= set(near)
    assert near == sorted(set(near))


def test_of_a_line_of_servers_few_are_looked_at() -> None:
    line = [Circle(Position(150.0 * number, 0.0), 100.0) for number in range(1_000)]
    near = AreaIndex(line).near(Position(75_000.0, 20.0), within_m=20.0)
    assert 500 in near
    assert len(near) < 5
