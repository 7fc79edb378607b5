"""How headings, payload commands and texts go to a vehicle, message by message."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import Bench, driven
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition, Position
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot
from upwash.sim.loop import run_virtually
from upwash.vehicle.px4.settings import Px4Settings

SETTINGS = Px4Settings(GeoPosition(39.3666, 22.9507))


def of_kind(sky: Bench, kind: str) -> list[Any]:
    return [message for message in sky.heard if message.get_type() == kind]


@pytest.mark.virtual
async def test_a_heading_is_part_of_the_setpoints_until_the_next_leg() -> None:
    async with driven(SETTINGS, FlightSettings(), ground_speed_m_s=5.0) as (sky, autopilot):
        await take_off(autopilot)
        await autopilot.turn_to(270.0)
        last = of_kind(sky, "SET_POSITION_TARGET_GLOBAL_INT")[-1]
        assert not last.type_mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
        assert last.yaw == pytest.approx(math.radians(-90))
        await autopilot.goto(Position(20.0, 0.0, 5.0))
        last = of_kind(sky, "SET_POSITION_TARGET_GLOBAL_INT")[-1]
        assert last.yaw == pytest.approx(math.radians(90)), "the nose points along the leg"
        await autopilot.return_home_and_land()


@pytest.mark.parametrize("size", [1, 49, 50, 51, 99, 100, 200])
def test_a_text_arrives_whole_in_as_many_chunks_as_it_takes(size: int) -> None:
    text = ("0123456789" * 20)[:size]

    async def say(autopilot: MavlinkAutopilot) -> None:
        autopilot.say(4, text)
        autopilot.say(4, text)
        await asyncio.sleep(0.1)

    async def mission() -> None:
        async with driven(SETTINGS, FlightSettings(), ground_speed_m_s=5.0) as (sky, autopilot):
            await say(autopilot)
            sent = of_kind(sky, "STATUSTEXT")
            assert {message.severity for message in sent} == {4}
            if size <= 50:
                assert [(message.text, message.id) for message in sent] == [(text, 0)] * 2
                return
            for number in (1, 2):
                chunks = [message for message in sent if message.id == number]
                assert [message.chunk_seq for message in chunks] == list(range(len(chunks)))
                assert "".join(message.text for message in chunks) == text
                assert {len(message.text) for message in chunks[:-1]} == {50}
                assert len(chunks[-1].text) < 50  # by which a receiver knows the last one

    run_virtually(mission())


@pytest.mark.virtual
async def test_a_payload_command_carries_its_parameters_and_zeros() -> None:
    async with driven(SETTINGS, FlightSettings(), ground_speed_m_s=5.0) as (sky, autopilot):
        await autopilot.claim(resumes=False)
        await autopilot.command(183, "DO_SET_SERVO", (9.0, 1500.0))
        sent = [message for message in of_kind(sky, "COMMAND_LONG") if message.command == 183][-1]
        assert [getattr(sent, f"param{number}") for number in range(1, 8)] == [9, 1500, 0, 0, 0, 0, 0]
