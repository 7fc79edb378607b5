"""The thesis's grid on the stand-in, on virtual time, beside the recorded flight of an ArduCopter."""

from __future__ import annotations

import statistics

import pytest
from bench.vehicle import HOME, Client, Times, fly_grid, recorded
from tests.vehicle.direct import directly_linked

from upwash.core.geo import Position
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings


async def fly(targets: list[Position]) -> Times:
    client = Client()
    async with directly_linked(VehicleSettings(home=HOME, armable_after_s=0.0), client.hear) as (_, say):
        client.send = say
        return await fly_grid(client, targets)


def test_the_grid_from_rest_takes_as_long_as_recorded() -> None:
    was, targets = recorded()
    flown = run_virtually(fly(targets))
    for flown_s, was_s in zip(flown.legs_s, was.legs_s, strict=True):
        assert flown_s == pytest.approx(was_s, rel=0.05)
    assert statistics.median(flown.legs_s) == pytest.approx(7.3, rel=0.02)
    assert flown.takeoff_s == pytest.approx(was.takeoff_s, rel=0.03)
    assert flown.grid_s == pytest.approx(was.grid_s, rel=0.02)
    assert flown.touchdown_s == pytest.approx(was.touchdown_s, rel=0.02)
    assert flown.total_s == pytest.approx(was.total_s, rel=0.02)
