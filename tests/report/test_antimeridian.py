"""Lines and rings that cross 180 degrees of longitude."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from upwash.report.antimeridian import cut_line, cut_ring


def test_a_line_that_crosses_is_cut_there_and_one_that_does_not_is_whole() -> None:
    there_and_back = [(179.0, 0.0, 10.0), (-179.0, 2.0, 20.0), (178.0, 2.0, 30.0)]
    assert cut_line(there_and_back) == [
        [(179.0, 0.0, 10.0), (180.0, 1.0, 15.0)],
        [(-180.0, 1.0, 15.0), (-179.0, 2.0, 20.0), (-180.0, 2.0, pytest.approx(23.3333333))],
        [(180.0, 2.0, pytest.approx(23.3333333)), (178.0, 2.0, 30.0)],
    ]
    assert cut_line([(22.0, 39.0), (23.0, 39.0), (23.0, 40.0)]) == [
        [(22.0, 39.0), (23.0, 39.0), (23.0, 40.0)]
    ]
    assert cut_line([(179.0, 1.0), (180.0, 1.0), (179.0, 2.0)]) == [
        [(179.0, 1.0), (180.0, 1.0), (179.0, 2.0)]
    ]


def test_a_line_that_stays_beyond_the_cut_is_whole() -> None:
    assert cut_line([(-179.0, 1.0), (-178.0, 1.0)]) == [[(-179.0, 1.0), (-178.0, 1.0)]]
    assert len(cut_line([(179.9, 0.0), (-179.9, 0.0), (-179.8, 0.0), (-179.7, 0.0)])) == 2


@pytest.mark.parametrize("middle_deg", [0.0, 120.0, 179.3, -179.6, 180.0])
def test_the_parts_of_a_ring_are_closed_turn_anticlockwise_and_have_its_area(middle_deg: float) -> None:
    angles = [math.tau * side / 64 for side in range(64)]
    corners = [(math.remainder(middle_deg + math.cos(angle), 360), 10 + math.sin(angle)) for angle in angles]
    rings = cut_ring([*corners, corners[0]])
    assert len(rings) == (1 if abs(middle_deg) < 179 else 2)
    assert all(ring[0] == ring[-1] for ring in rings)
    assert all(-180 <= longitude_deg <= 180 for ring in rings for longitude_deg, _ in ring)
    areas = [sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise(ring)) / 2 for ring in rings]
    assert min(areas) > 0
    assert sum(areas) == pytest.approx(32 * math.sin(math.tau / 64), rel=1e-6)
