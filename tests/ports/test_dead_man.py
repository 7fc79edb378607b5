"""The dead man in the autopilot: installed, set, taken back, and what it does when a program falls silent."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest
from tests.played import played
from tests.ports.memory import AGILE, Air, Bench, bench
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import Position
from upwash.core.vehicle.control import Owner
from upwash.errors import AutopilotOverruled, AutopilotRefused
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.dead_man import FILE, SILENCE_S, VERSION, promise, script
from upwash.real.mavlink.ftp import FileClient
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings

SILENCE = 20.0
LOOK_S = 0.05
Story = Callable[[Bench], Awaitable[None]]
Tell = Callable[..., None]


@pytest.fixture
def tell(monkeypatch: pytest.MonkeyPatch) -> Tell:
    """Runs a story with a stand-in, on virtual time."""

    def told(story: Story, *, settings: VehicleSettings = AGILE, air: Air | None = None) -> None:
        async def live() -> None:
            async with bench(settings, air or Air(0.0, seed=1)) as made:
                await story(made)

        run_virtually(live())

    return told


async def install(made: Bench) -> None:
    async with made.program() as autopilot:
        await autopilot.claim(resumes=False)
        assert await autopilot.dead_man.install() == ""
        assert await autopilot.dead_man.missing() == ""


async def fly_out(autopilot: MavlinkAutopilot) -> None:
    await autopilot.claim(resumes=False)
    await autopilot.dead_man.watch(silence_s=SILENCE, action="return")
    await take_off(autopilot)
    await autopilot.goto(Position(50.0, 0.0, 5.0))


def flies_in(made: Bench, mode: CopterMode) -> bool:
    return made.copter.mode is mode and made.copter.flying(made.now_s)


async def leaves_guided(made: Bench, *, within_s: float) -> float:
    """After how long it does; fails if it does not."""
    begun_s = made.now_s
    for _ in range(round(within_s / LOOK_S)):
        if made.copter.mode is not CopterMode.GUIDED:
            return made.now_s - begun_s
        await asyncio.sleep(LOOK_S)
    raise AssertionError(f"still in GUIDED after {within_s} s")


async def killed_in_flight(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await fly_out(autopilot)
        assert made.parameter(SILENCE_S) == SILENCE


# --- what is in the autopilot -------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_it_is_uploaded_started_and_read_back(tell: Tell, share: float) -> None:
    async def story(made: Bench) -> None:
        async with made.program() as autopilot:
            assert "was not started; install it with" in await autopilot.dead_man.missing()
        await install(made)
        version, text = script()
        assert bytes(made.firmware.files.content[f"scripts/{FILE}"]) == text
        assert made.parameter(VERSION) == version

    tell(story, air=Air(share, seed=7))


@played("tell")
async def test_an_older_one_is_replaced(made: Bench) -> None:
    await install(made)
    older = script()[1].replace(str(script()[0]).encode(), b"12")
    made.firmware.files.content[f"scripts/{FILE}"] = bytearray(older + b"-- and it was longer")
    made.copter.parameters.change(VERSION, 12)
    async with made.program() as autopilot:
        assert "another version" in await autopilot.dead_man.missing()
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match="another version of upwash; install it"):
            await autopilot.dead_man.watch(silence_s=SILENCE, action="return")
    await install(made)
    assert bytes(made.firmware.files.content[f"scripts/{FILE}"]) == script()[1]


@played("tell")
async def test_scripting_that_is_off_is_switched_on_for_the_next_start(made: Bench) -> None:
    made.copter.parameters.change("SCR_ENABLE", 0)
    async with made.program() as autopilot:
        assert "SCR_ENABLE is 0" in await autopilot.dead_man.missing()
        await autopilot.claim(resumes=False)
        assert "switch the autopilot off and on" in await autopilot.dead_man.install()
    assert made.parameter("SCR_ENABLE") == 1
    assert bytes(made.firmware.files.content[f"scripts/{FILE}"]) == script()[1]


@played("tell")
async def test_nothing_is_installed_in_a_vehicle_that_is_armed(made: Bench) -> None:
    async with made.program() as autopilot:
        await claim_and_arm(autopilot)
        with pytest.raises(AutopilotRefused, match="the vehicle is armed"):
            await autopilot.dead_man.install()
    async with made.program() as another:
        with pytest.raises(AutopilotOverruled):
            await another.dead_man.install()
    assert not made.firmware.files.content


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_files_arrive_whole_over_a_bad_link(tell: Tell, share: float) -> None:
    content = bytes(range(256)) * 20 + b"the end"

    async def story(made: Bench) -> None:
        async with made.program() as autopilot:
            client = FileClient(autopilot.vehicle)
            assert await client.has_directory("scripts")
            assert not await client.has_directory("APM")
            await client.make_directory("APM")
            await client.make_directory("APM")
            assert await client.read("APM/none.lua") is None
            for text in (content, b"", content[:239]):
                await client.write("APM/some.lua", text)
                assert bytes(made.firmware.files.content["APM/some.lua"]) == text
                assert await client.read("APM/some.lua") == text

    tell(story, air=Air(share, seed=11))


@pytest.mark.parametrize("silence_s", [0.0, -1.0, 820.0])
def test_a_silence_that_a_heartbeat_cannot_hold_is_refused(silence_s: float) -> None:
    with pytest.raises(ValueError, match="cannot be promised"):
        promise(silence_s, "return")


def test_the_script_and_the_driver_use_the_same_words() -> None:
    version, text = script()
    assert f"local VERSION = {version}\n".encode() in text and b"@" not in text
    assert promise(20.0, "return") == 0x5550 << 16 | 1 << 13 | 200
    for word in (b"MAGIC = 0x5550", b"{[1] = RTL, [2] = LAND}", b"& 8191", b'"upwash: companion silent, "'):
        assert word in text
    assert {VERSION, SILENCE_S} == {f"UPW_{name}" for name in ("VERSION", "SILENCE_S")}
    assert all(f'"{name.removeprefix("UPW_")}"'.encode() in text for name in (VERSION, SILENCE_S))


# --- what it does -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("action", "mode"), [("return", CopterMode.RTL), ("land", CopterMode.LAND)])
@played("tell")
async def test_a_program_that_is_killed_in_flight_is_missed_in_time(
    made: Bench, *, action: str, mode: CopterMode
) -> None:
    await install(made)
    async with made.program() as autopilot:
        await autopilot.claim(resumes=False)
        await autopilot.dead_man.watch(silence_s=SILENCE, action=action)  # type: ignore[arg-type]
        await take_off(autopilot)
    took_s = await leaves_guided(made, within_s=SILENCE)
    assert took_s > SILENCE - 3.0
    assert made.copter.mode is mode
    assert f"upwash: companion silent, {mode.name}" in made.said


@played("tell")
async def test_a_program_that_lives_is_not_missed_and_says_goodbye(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await fly_out(autopilot)
        await asyncio.sleep(3 * SILENCE)
        assert flies_in(made, CopterMode.GUIDED)
        await autopilot.return_home_and_land()
        await autopilot.disarm()
        await autopilot.dead_man.release()
        assert made.parameter(SILENCE_S) == 0
    await asyncio.sleep(2 * SILENCE)
    assert not any("silent" in text for text in made.said)


@played("tell")
async def test_after_a_goodbye_in_the_air_nothing_happens(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await fly_out(autopilot)
        await autopilot.dead_man.release()
    await asyncio.sleep(3 * SILENCE)
    assert flies_in(made, CopterMode.GUIDED)


@pytest.mark.parametrize("takes_s", [0.0, 8.0])
def test_it_is_silent_while_a_pilot_flies(tell: Tell, takes_s: float) -> None:
    """Also where the pilot goes back to GUIDED, in which nobody then flies."""

    async def story(made: Bench) -> None:
        await killed_in_flight(made)
        await asyncio.sleep(takes_s)
        made.copter.change_mode(made.now_s, CopterMode.LOITER)
        await asyncio.sleep(3 * SILENCE)
        assert flies_in(made, CopterMode.LOITER)
        made.copter.change_mode(made.now_s, CopterMode.GUIDED)
        await asyncio.sleep(3 * SILENCE)
        assert flies_in(made, CopterMode.GUIDED)
        assert not any("silent" in text for text in made.said)

    tell(story)


@played("tell")
async def test_a_program_that_lost_the_vehicle_to_a_pilot_is_not_missed(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await fly_out(autopilot)
        made.copter.change_mode(made.now_s, CopterMode.LOITER)
        await asyncio.sleep(3.0)
        assert autopilot.control.owner is Owner.UNKNOWN
        made.copter.change_mode(made.now_s, CopterMode.GUIDED)
        await asyncio.sleep(3.0)
        assert made.parameter(SILENCE_S) == 0
    await asyncio.sleep(3 * SILENCE)
    assert flies_in(made, CopterMode.GUIDED)


@played("tell")
async def test_a_program_that_is_resumed_in_time_is_missed_anew(made: Bench) -> None:
    await killed_in_flight(made)
    await asyncio.sleep(SILENCE / 2)
    async with made.program() as autopilot:
        await autopilot.claim(resumes=True)
        await autopilot.dead_man.watch(silence_s=SILENCE, action="return")
        await asyncio.sleep(3 * SILENCE)
        assert flies_in(made, CopterMode.GUIDED)
    assert await leaves_guided(made, within_s=SILENCE) > SILENCE - 3.0


@played("tell")
async def test_a_program_that_never_claims_neither_holds_it_off_nor_takes_it_back(made: Bench) -> None:
    await killed_in_flight(made)
    async with made.program():
        assert await leaves_guided(made, within_s=SILENCE) > SILENCE - 3.0


@played("tell")
async def test_nothing_happens_on_the_ground(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await autopilot.claim(resumes=False)
        await autopilot.dead_man.watch(silence_s=SILENCE, action="return")
        await autopilot.ready()
        await autopilot.arm()
    await asyncio.sleep(2 * SILENCE)
    assert made.copter.mode is CopterMode.GUIDED
    assert made.parameter(SILENCE_S) == 0


@played("tell")
async def test_a_program_that_died_before_arming_is_not_missed_in_anothers_flight(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await autopilot.claim(resumes=False)
        await autopilot.dead_man.watch(silence_s=SILENCE, action="return")
    async with made.program() as another:
        await take_off(another)
        await asyncio.sleep(3 * SILENCE)
    await asyncio.sleep(3 * SILENCE)
    assert flies_in(made, CopterMode.GUIDED)


# --- what the program makes of it ---------------------------------------------------------------------------


@pytest.mark.parametrize("mute", [True, False])
def test_where_the_link_alone_is_lost_a_fail_safe_has_the_vehicle(tell: Tell, mute: bool) -> None:
    """With its words lost too, or heard."""

    async def story(made: Bench) -> None:
        await install(made)
        async with made.program() as autopilot:
            await fly_out(autopilot)
            made.deaf, made.mute = True, mute
            await leaves_guided(made, within_s=SILENCE)
            await asyncio.sleep(2.0)
            made.deaf = made.mute = False
            await asyncio.sleep(2.0)
            assert autopilot.control.owner is Owner.FAILSAFE
            assert "its dead man" in autopilot.control.why

    tell(story, settings=replace(AGILE, return_speed_m_s=1.0))


@played("tell", settings=replace(AGILE, return_speed_m_s=1.0))
async def test_a_short_silence_makes_a_pilot_no_fail_safe(made: Bench) -> None:
    await install(made)
    async with made.program() as autopilot:
        await fly_out(autopilot)
        made.deaf = made.mute = True
        await asyncio.sleep(SILENCE / 2)
        made.copter.change_mode(made.now_s, CopterMode.RTL)
        made.deaf = made.mute = False
        await asyncio.sleep(2.0)
        assert autopilot.control.owner is Owner.UNKNOWN
