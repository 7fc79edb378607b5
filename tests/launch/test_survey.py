"""What `upwash check --vehicle` finds out of a vehicle, from a stand-in on loopback."""

from __future__ import annotations

import asyncio

import pytest
from tests.scenarios import scenario

from upwash.core.geo import GeoPosition
from upwash.launch.survey import VehicleSurvey, survey_vehicle
from upwash.mavlink.version import Version
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)


def surveyed(settings: VehicleSettings | Px4Settings) -> VehicleSurvey:
    async def survey() -> VehicleSurvey:
        vehicle = await serve_vehicle("tcp:127.0.0.1:0", settings)
        config = scenario(
            mission={"home": {"latitude_deg": HOME.latitude_deg, "longitude_deg": HOME.longitude_deg}},
            autopilot={"connection": vehicle.address},
        )
        try:
            return await survey_vehicle(config, install_dead_man=False)
        finally:
            await vehicle.close()

    return asyncio.run(survey())


@pytest.mark.parametrize(
    ("version", "unfit"),
    [(Version(4, 6, 2), ""), (Version(4, 7), ""), (Version(4, 0, 7), "ArduCopter 4.1.0")],
)
def test_a_version_that_is_too_old_makes_a_vehicle_unfit(version: Version, unfit: str) -> None:
    found = surveyed(VehicleSettings(HOME, armable_after_s=0.0, version=version))
    assert found.version == str(version)
    assert unfit in found.unfit
    assert bool(unfit) == bool(found.unfit)


@pytest.mark.parametrize(
    ("parameters", "named", "unfit"),
    [
        ({"COM_OBL_RC_ACT": 0.0}, {"COM_OBL_RC_ACT", "COM_RC_OVERRIDE"}, ""),
        ({"COM_OBL_RC_ACT": 7.0}, set(), "COM_OBL_RC_ACT is 7 (disarm)"),
    ],
)
def test_parameters_that_a_person_should_know_of_are_named(
    parameters: dict[str, float], named: set[str], unfit: str
) -> None:
    found = surveyed(Px4Settings(HOME, parameters=parameters))
    assert {setting.name for setting in found.settings} == named
    assert unfit in found.unfit
