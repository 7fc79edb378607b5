"""Any sequence of well-formed messages in the vehicle's name ends no link."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest
from tests.fuzz.messages import messages
from tests.ports.memory import driven

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotError
from upwash.eventlog.schema import LinkTrouble
from upwash.ports import VehicleNews
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings

HOME = GeoPosition(39.3666, 22.9507)
VEHICLES: dict[str, VehicleSettings | Px4Settings] = {
    "ArduCopter": VehicleSettings(HOME, home_altitude_m=488.0, armable_after_s=0.0),
    "PX4": Px4Settings(HOME, armable_after_s=0.0),
}
AT_ONCE = 20


def spoken(seed: int, count: int, settings: VehicleSettings | Px4Settings) -> list[VehicleNews]:
    """Has the driver hear so many messages, and learn of the vehicle meanwhile; the news of the vehicle."""
    news: list[VehicleNews] = []

    async def heard() -> None:
        errors: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context))
        async with driven(settings) as (sky, autopilot):
            autopilot.listen(news.append)
            learning = asyncio.create_task(autopilot.limits())
            said = itertools.islice(messages(seed), count)
            while batch := list(itertools.islice(said, AT_ONCE)):
                for message in batch:
                    sky.connection.send(message)
                await asyncio.sleep(0.02)
            assert autopilot.vehicle.linked
            repr(
                (
                    autopilot.telemetry,
                    autopilot.position,
                    autopilot.control,
                    autopilot.energy,
                    autopilot.stands,
                )
            )
            try:
                await learning
            except AutopilotError as error:
                assert str(error)
        assert not errors

    run_virtually(heard())
    return news


@pytest.mark.parametrize("kind", VEHICLES)
@pytest.mark.parametrize("seed", range(4))
def test_the_driver_hears_any_messages_without_a_defect(seed: int, kind: str) -> None:
    news = spoken(seed, 3_000, VEHICLES[kind])
    assert not [each for each in news if isinstance(each, LinkTrouble) and each.about == "defect"]
