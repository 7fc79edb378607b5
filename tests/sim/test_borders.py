"""Whoever waits for a simulated vehicle to cross a border is told of each crossing, whatever it was doing before."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from upwash.config.world import FaultConfig
from upwash.core.geo import Circle, Position
from upwash.errors import AutopilotOverruled
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.vehicle import Plain

AREA = [Circle(Position(100.0, 0.0), 20.0)]
PLAIN = Plain(acceleration_m_s2=1.0, takeoff_s=5.0, return_and_land_s=10.0)


async def hovering(**other: object) -> ModelAutopilot:
    autopilot = ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=5.0, manner=PLAIN, **other)  # type: ignore[arg-type]
    await autopilot.claim(resumes=False)
    await autopilot.arm()
    await autopilot.takeoff(5.0)
    return autopilot


@pytest.mark.virtual
async def test_a_border_is_told_to_who_has_waited_since_before_the_leg_that_crosses_it() -> None:
    autopilot = await hovering()
    crossing = asyncio.create_task(autopilot.border_crossed(AREA))
    await autopilot.goto(Position(50.0, 0.0, 5.0))
    assert not crossing.done()
    leg = asyncio.create_task(autopilot.goto(Position(100.0, 0.0, 5.0)))
    await crossing
    assert autopilot.position.east_m == pytest.approx(80.0, abs=0.01)
    await leg


@pytest.mark.virtual
async def test_a_border_is_told_once_if_a_timer_is_due_a_moment_before() -> None:
    autopilot = await hovering()
    loop, here, there = asyncio.get_running_loop(), Position(0.0, 0.0, 5.0), Position(100.0, 0.0, 5.0)
    begun_s, leg = loop.time(), asyncio.create_task(autopilot.goto(there))
    await autopilot.border_crossed(AREA)
    takes_s = loop.time() - begun_s
    await leg
    await autopilot.goto(here)
    loop.call_later(takes_s - 5e-10, lambda: None)
    leg, told = asyncio.create_task(autopilot.goto(there)), 0
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(60.0):
            while told < 3:
                await autopilot.border_crossed(AREA)
                told += 1
    assert told == 1
    await leg


@pytest.mark.virtual
async def test_a_border_that_the_vehicle_turns_away_from_is_not_told() -> None:
    autopilot = await hovering()
    crossing = asyncio.create_task(autopilot.border_crossed(AREA))
    leg = asyncio.create_task(autopilot.goto(Position(100.0, 0.0, 5.0)))
    await asyncio.sleep(10.0)
    leg.cancel()
    await autopilot.hold()
    await asyncio.sleep(60.0)
    assert not crossing.done()
    crossing.cancel()


@pytest.mark.virtual
async def test_a_pilot_who_lands_before_the_border_crosses_none() -> None:
    pilot = FaultConfig(target="autopilot", kind="pilot", from_s=12.0, to_s=20.0)
    autopilot = await hovering(incidents=[pilot])
    crossing = asyncio.create_task(autopilot.border_crossed(AREA))
    with pytest.raises(AutopilotOverruled):
        await autopilot.goto(Position(100.0, 0.0, 5.0))
    assert asyncio.get_running_loop().time() == pytest.approx(12.0)
    await asyncio.sleep(60.0)
    assert not crossing.done(), "it has landed before the border"
    crossing.cancel()
