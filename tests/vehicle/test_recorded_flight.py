"""The thesis's grid on the stand-in, at speed-up, beside the recorded flight of an ArduCopter."""

from __future__ import annotations

import asyncio

import pytest
from bench.vehicle import fly_grid, recorded


def test_the_grid_from_rest_takes_as_long_as_recorded() -> None:
    was, targets = recorded()
    flown = asyncio.run(fly_grid(targets, speedup=25.0))
    for flown_s, was_s in zip(flown.legs_s, was.legs_s, strict=True):
        assert flown_s == pytest.approx(
            was_s, abs=0.25
        )  # the clock is read ten times a second, on both sides
    assert sorted(flown.legs_s)[len(flown.legs_s) // 2] == pytest.approx(7.3, rel=0.02)
    assert flown.takeoff_s == pytest.approx(was.takeoff_s, rel=0.03)
    assert flown.touchdown_s == pytest.approx(was.touchdown_s, rel=0.02)
    assert flown.total_s == pytest.approx(was.total_s, rel=0.02)
