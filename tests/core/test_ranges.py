from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.ranges import Ranges

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
