"""The simulated vehicle stands on the ground when it has landed, not a rounding error above it."""

from __future__ import annotations

import asyncio
import random

from upwash.core.geo import Position
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.loop import run_virtually
from upwash.sim.vehicle import Plain


def test_it_can_always_be_disarmed_after_landing() -> None:
    async def fly(chance: random.Random) -> None:
        manner = Plain(
            acceleration_m_s2=1.0, takeoff_s=5.0, return_and_land_s=round(chance.uniform(1.0, 16.0), 2)
        )
        autopilot = ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=4.0, manner=manner)
        await asyncio.sleep(chance.uniform(0.0, 50.0))
        for come_down in (autopilot.land, autopilot.return_home_and_land):
            await autopilot.claim(resumes=False)
            await autopilot.arm()
            await autopilot.takeoff(5.0)
            await autopilot.goto(Position(chance.uniform(0.0, 99.0), chance.uniform(0.0, 99.0), 5.0))
            await come_down()
            await autopilot.disarm()

    for seed in range(100):
        run_virtually(fly(random.Random(seed)))
