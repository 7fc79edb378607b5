"""Who covers what: on positions and circles alone."""

from __future__ import annotations

import math

import pytest

from upwash.core.geo import Circle, Position
from upwash.eventlog.narration import spans
from upwash.lab.observer import RangeInterval
from upwash.preflight.waypoints import coverage, uncovered

PLACES = [Position(east_m, 0.0) for east_m in (0.0, 50.0, 100.0, 150.0)]
AREAS = {"near": Circle(Position(25.0, 0.0), 25.0), "far": Circle(Position(0.0, 500.0), 100.0)}


def test_a_server_covers_the_waypoints_in_its_range_border_included() -> None:
    near, far = coverage(PLACES, AREAS, [], ended_s=100.0)
    assert (near.server, near.waypoints, near.nearest_m) == ("near", (0, 1), 25.0)
    assert (far.server, far.waypoints, far.nearest_m) == ("far", (), 500.0)
    assert uncovered(len(PLACES), (near, far)) == (2, 3)


def test_the_longest_stay_is_of_this_server_and_ends_with_the_mission() -> None:
    stays = [
        RangeInterval("near", 0.0, 20.0),
        RangeInterval("far", 0.0, 90.0),
        RangeInterval("near", 60.0, math.inf),
    ]
    near, far = coverage(PLACES, AREAS, stays, ended_s=100.0)
    assert (near.longest_stay_s, far.longest_stay_s) == (40.0, 90.0)
    assert coverage(PLACES, AREAS, [], ended_s=100.0)[0].longest_stay_s == 0.0


@pytest.mark.parametrize(
    ("indices", "written"),
    [((), ""), ((4,), "4"), ((0, 1, 2), "0-2"), ((0, 2, 3, 9), "0, 2-3, 9")],
)
def test_spans_are_written_as_a_person_would(indices: tuple[int, ...], written: str) -> None:
    assert spans(indices) == written
