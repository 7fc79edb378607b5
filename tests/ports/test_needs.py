"""Which firmware is flown: by its version, and by what it knows, before anything turns."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, AT_ONCE, Bench, driven
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import GeoPosition, Position
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.mavlink.px4 import CURRENT_MODE
from upwash.mavlink.version import Version
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.needs import require_reposition
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot import commands
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.connection import PeerConnection
from upwash.vehicle.px4.settings import Px4Settings

REPOSITION, ARM = mavlink.MAV_CMD_DO_REPOSITION, mavlink.MAV_CMD_COMPONENT_ARM_DISARM
VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
PX4 = Px4Settings(GeoPosition(39.3666, 22.9507), parameters={"COM_OBL_RC_ACT": 3.0})
Story = Callable[[Bench, MavlinkAutopilot], Awaitable[None]]


def tell(story: Story, settings: VehicleSettings = AGILE, *, discreet: bool = False) -> None:
    """Runs a story with a stand-in ArduCopter, on virtual time; it may keep its version to itself."""

    async def live() -> None:
        before = keep_version_back if discreet else None
        async with driven(settings, AT_ONCE, 60.0, before) as (made, autopilot):
            await story(made, autopilot)

    run_virtually(live())


async def keep_version_back(made: Bench) -> None:
    made.firmware.reports = {
        number: report for number, report in made.firmware.reports.items() if number != VERSION
    }


@played(tell, replace(AGILE, version=Version(4, 0, 7)))
async def test_an_old_version_is_refused_before_arming(made: Bench, autopilot: MavlinkAutopilot) -> None:
    await autopilot.claim(resumes=False)
    refusal = "runs ArduCopter 4.0.7; upwash flies ArduCopter 4.1.0 and newer.*update the vehicle's firmware"
    with pytest.raises(AutopilotRefused, match=refusal):
        await autopilot.ready()
    assert made.commands() == []


@pytest.mark.parametrize("discreet", [False, True])
def test_a_firmware_that_does_not_know_how_to_be_sent_to_a_place_is_refused_before_arming(
    monkeypatch: pytest.MonkeyPatch, *, discreet: bool
) -> None:
    monkeypatch.delitem(commands._HANDLERS, REPOSITION)

    async def story(made: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.claim(resumes=False)
        version = "of a version that it does not tell" if discreet else "4.7.0-dev"
        refusal = f"the vehicle, ArduCopter {version}, does not know MAV_CMD_DO_REPOSITION"
        await autopilot.ready()
        with pytest.raises(AutopilotRefused, match=refusal):
            await autopilot.arm()
        assert made.commands()[-1] == REPOSITION
        assert ARM not in made.commands()

    tell(story, discreet=discreet)


@played(tell)
async def test_the_try_moves_nothing_and_changes_no_mode(made: Bench, autopilot: MavlinkAutopilot) -> None:
    for mode in (CopterMode.STABILIZE, CopterMode.GUIDED):
        made.copter.change_mode(made.now_s, mode)
        await autopilot.claim(resumes=False)
        await require_reposition(autopilot.vehicle)
        assert made.copter.mode is mode
    assert made.commands() == [REPOSITION, REPOSITION]
    await claim_and_arm(autopilot)
    assert made.copter.target(made.now_s) is None


@played(tell)
async def test_nothing_is_tried_on_a_vehicle_that_a_pilot_has(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    await autopilot.claim(resumes=False)
    made.copter.arm(made.now_s, forced=True)
    await asyncio.sleep(0.07)  # no heartbeat comes meanwhile
    assert not autopilot.armed
    with pytest.raises(AutopilotOverruled):
        await autopilot.arm()
    assert made.commands() == []


@played(tell, discreet=True)
async def test_a_vehicle_that_does_not_tell_its_version_is_flown(
    _: Bench, autopilot: MavlinkAutopilot
) -> None:
    assert autopilot.vehicle.version is None
    await take_off(autopilot)
    await autopilot.goto(Position(20.0, 0.0, 5.0))


def test_a_firmware_that_only_knows_the_old_question_is_asked_that(monkeypatch: pytest.MonkeyPatch) -> None:
    known = PeerConnection._obey

    def obey(to: PeerConnection, message: Any) -> Any:
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and message.param1 == VERSION:
            return (mavlink.MAV_RESULT_UNSUPPORTED,)
        return known(to, message)

    monkeypatch.setattr(PeerConnection, "_obey", obey)

    async def story(_: Bench, autopilot: MavlinkAutopilot) -> None:
        assert str(autopilot.vehicle.version) == "4.5.7"

    tell(story, replace(AGILE, version=Version(4, 5, 7)))


@pytest.mark.parametrize(
    ("version", "refusal"),
    [
        (Version(1, 14, 3), "runs PX4 1.14.3; upwash flies PX4 1.15.0 and newer, with CURRENT_MODE"),
        (Version(0, 0, 0, 0), "PX4 of a version that it does not tell, does not report CURRENT_MODE"),
    ],
)
@pytest.mark.virtual
async def test_a_px4_that_does_not_report_its_intended_mode_is_refused_before_arming(
    *, version: Version, refusal: str
) -> None:
    async with driven(replace(PX4, version=version)) as (sky, autopilot):
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match=refusal):
            await autopilot.ready()
        assert sky.commands() == []


@pytest.mark.virtual
async def test_a_px4_in_development_without_a_version_is_flown_by_what_it_reports() -> None:
    async with driven(PX4, before=keep_version_back) as (sky, autopilot):
        assert autopilot.vehicle.version is None
        await claim_and_arm(autopilot)
        assert sky.copter.armed
        assert CURRENT_MODE in sky.vehicle.firmware.reports
