"""A second battery of each stand-in, as the driver hears of it."""

from __future__ import annotations

import asyncio

import pytest
from tests.played import played
from tests.ports.memory import Bench, driven

from upwash.core.geo import GeoPosition
from upwash.real.mavlink import MavlinkAutopilot
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.copter import FaultKind, SecondBattery
from upwash.vehicle.px4.settings import Px4Settings

HOME = GeoPosition(39.3666, 22.9507)
SECOND = SecondBattery(percent=40.0, endurance_s=300.0)
STAGES = {"BATT2_LOW_MAH": 660.0, "BATT_LOW_MAH": 330.0}


async def charges_of(autopilot: MavlinkAutopilot) -> tuple[dict[int, float | None], float | None, int | None]:
    await asyncio.sleep(4.0)
    told = autopilot.telemetry
    return dict(told.batteries), told.battery_percent, told.lowest_battery


@pytest.mark.parametrize("kind", [VehicleSettings, Px4Settings])
@pytest.mark.virtual
async def test_the_lowest_of_two_batteries_counts(kind: type[VehicleSettings] | type[Px4Settings]) -> None:
    async with driven(kind(HOME, second_battery=SECOND)) as (bench, autopilot):
        assert await charges_of(autopilot) == ({1: 100.0, 2: 40.0}, 40.0, 2)
        bench.copter.fail(FaultKind.BATTERY, bench.now_s)
        charges, percent, lowest = await charges_of(autopilot)
        assert (charges[2], lowest) == (40.0, 1)
        assert percent is not None and percent <= 8.0


@pytest.mark.parametrize("kind", [VehicleSettings, Px4Settings])
@pytest.mark.virtual
async def test_the_only_battery_has_no_number(kind: type[VehicleSettings] | type[Px4Settings]) -> None:
    async with driven(kind(HOME)) as (_, autopilot):
        assert await charges_of(autopilot) == ({1: 100.0}, 100.0, None)


def told(story: object, **settings: object) -> None:
    async def flown() -> None:
        async with driven(VehicleSettings(HOME, **settings)) as (bench, autopilot):  # type: ignore[arg-type]
            await story(bench, autopilot)  # type: ignore[operator]

    run_virtually(flown())


@played(told, second_battery=SECOND, parameters=STAGES)
async def test_each_battery_of_an_arducopter_has_its_own_low_stage(
    _: Bench, autopilot: MavlinkAutopilot
) -> None:
    await charges_of(autopilot)
    await autopilot.claim(resumes=False)
    await autopilot.limits()
    assert (autopilot.energy.low_percent_of(1), autopilot.energy.low_percent_of(2)) == (10.0, 20.0)


@played(told, parameters=STAGES)
async def test_a_second_battery_that_is_not_reported_is_not_asked_for(
    _: Bench, autopilot: MavlinkAutopilot
) -> None:
    await charges_of(autopilot)
    await autopilot.claim(resumes=False)
    await autopilot.limits()
    assert autopilot.energy.low_percents == {}
