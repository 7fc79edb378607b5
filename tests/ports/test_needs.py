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
from tests.ports.scripted import Px4Script, Script, scripted
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import GeoPosition, Position
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
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


# --- vehicles of single messages ----------------------------------------------------------------------------


def of_version(kind: type[Script], version: int | None) -> type[Script]:
    return type("Other", (kind,), {"version": version})


@pytest.mark.parametrize(
    ("kind", "version", "flown"),
    [
        (Script, (4, 1, 0), True),
        (Script, (4, 0, 99), False),
        (Script, (5, 0, 0), True),
        (Px4Script, (1, 15, 0), True),
        (Px4Script, (1, 14, 99), False),
        (Px4Script, (2, 0, 0), True),
    ],
)
@pytest.mark.virtual
async def test_the_oldest_version_that_is_flown(
    kind: type[Script], version: tuple[int, int, int], *, flown: bool
) -> None:
    major, minor, patch = version
    async with scripted(kind=of_version(kind, major << 24 | minor << 16 | patch << 8 | 255)) as script:
        inspecting = asyncio.ensure_future(script.autopilot.inspect())
        if flown:
            await inspecting
        else:
            with pytest.raises(AutopilotRefused, match="update the vehicle's firmware; it was not armed"):
                await inspecting


@pytest.mark.virtual
async def test_a_version_is_asked_for_three_times_in_two_ways() -> None:
    async with scripted(kind=of_version(Script, None)) as script:
        assert script.autopilot.vehicle.version is None
        assert len(script.asked_for(VERSION)) == 3
        old = script.commands(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES)
        assert [message.param1 for message in old] == [1.0] * 3


@pytest.mark.virtual
async def test_a_px4_that_does_not_tell_its_intended_mode_is_asked_eight_times() -> None:
    async with scripted(kind=Px4Script) as script:
        told = script.told()
        del told[CURRENT_MODE]
        script.told = lambda: told  # type: ignore[method-assign]
        with pytest.raises(AutopilotRefused, match=r"PX4 4\.6\.0, does not report CURRENT_MODE"):
            await script.autopilot.inspect()
        assert len(script.asked_for(CURRENT_MODE)) == 8


COMES_DOWN = "comes down where it is, unless a pilot has it by stick"
SAFE = {"COM_OBL_RC_ACT": 3.0, "COM_OF_LOSS_T": 1.0, "COM_RC_OVERRIDE": 3.0}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        *[("COM_OBL_RC_ACT", value, COMES_DOWN) for value in (0.0, 1.0, 2.0)],
        ("COM_OBL_RC_ACT", 3.0, ""),
        ("COM_OBL_RC_ACT", 4.0, "without the program the vehicle lands; 3 has it return, 5 hover"),
        ("COM_OBL_RC_ACT", 5.0, ""),
        ("COM_OF_LOSS_T", 10.0, ""),
        ("COM_OF_LOSS_T", 10.5, "only after that many seconds"),
        ("COM_RC_OVERRIDE", 0.0, "sticks do not take the vehicle"),
        ("COM_RC_OVERRIDE", 1.0, "sticks do not take the vehicle"),
        ("COM_RC_OVERRIDE", 2.0, ""),
        ("COM_OBL_RC_ACT", None, "it may fall"),
        ("COM_OF_LOSS_T", None, "is not known"),
        ("COM_RC_OVERRIDE", None, "is not known"),
    ],
)
@pytest.mark.virtual
async def test_settings_of_a_px4_that_may_surprise_are_told(
    name: str, value: float | None, said: str
) -> None:
    async with scripted(kind=Px4Script) as script:
        known = {key: number for key, number in (SAFE | {name: value}).items() if number is not None}
        script.parameters |= known
        await script.autopilot.inspect()
        settings = [news for news in script.news if isinstance(news, VehicleSetting)]
        assert [(news.name, news.value) for news in settings] == ([(name, value)] if said else [])
        assert all(said in news.advice for news in settings)


@pytest.mark.parametrize(
    ("action", "word"),
    [(6.0, r"6 \(terminate\)"), (7.0, r"7 \(disarm\)")],
)
@pytest.mark.virtual
async def test_a_px4_that_falls_without_the_program_is_refused(action: float, word: str) -> None:
    async with scripted(kind=Px4Script) as script:
        script.parameters |= SAFE | {"COM_OBL_RC_ACT": action}
        with pytest.raises(AutopilotRefused, match=f"COM_OBL_RC_ACT is {word}: the vehicle falls"):
            await script.autopilot.inspect()


@pytest.mark.parametrize(
    ("result", "armed", "tries", "flown"),
    [
        (mavlink.MAV_RESULT_DENIED, False, 1, True),
        (mavlink.MAV_RESULT_FAILED, False, 1, True),
        (mavlink.MAV_RESULT_UNSUPPORTED, False, 1, False),
        (mavlink.MAV_RESULT_UNSUPPORTED, True, 0, True),
    ],
)
@pytest.mark.virtual
async def test_targets_are_tried_on_a_disarmed_vehicle(
    result: int, *, armed: bool, tries: int, flown: bool
) -> None:
    async with scripted(armed=armed) as script:
        script.results[REPOSITION] = result
        await script.autopilot.claim(resumes=armed)
        trying = asyncio.ensure_future(require_reposition(script.autopilot.vehicle))
        if flown:
            await trying
        else:
            with pytest.raises(AutopilotRefused, match=r"ArduCopter 4\.6\.0, does not know"):
                await trying
        sent = script.commands(REPOSITION)
        assert len(sent) == tries
        for message in sent:
            assert abs(message.x) > 90e7 and abs(message.y) > 180e7, "a place on no Earth"
            assert message.param2 == 0, "it does not change the mode"


@pytest.mark.virtual
async def test_targets_are_not_tried_on_a_vehicle_of_another() -> None:
    async with scripted(armed=True) as script:
        with pytest.raises(AutopilotOverruled):
            await require_reposition(script.autopilot.vehicle)
        assert script.commands(REPOSITION) == []
