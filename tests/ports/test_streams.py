"""How often the vehicle's reports come: on every link, and whoever else sets their rates."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, AT_ONCE, Air, Bench, bench, driven

from upwash.eventlog.schema import LinkTrouble
from upwash.mavlink.px4 import CURRENT_MODE, Mode
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.px4_firmware import PX4
from upwash.sim.loop import run_virtually
from upwash.vehicle.body.connection import PeerConnection
from upwash.vehicle.px4.settings import Px4Settings

POSITION, HEARTBEAT = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_HEARTBEAT
GROUPS = (1, 2, 3, 6, 10, 11, 12)
NEEDED_HZ = {
    POSITION: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
}


@dataclass
class Counted:
    """What came of the vehicle, by message number, and what was told of its link."""

    autopilot: MavlinkAutopilot
    came: Counter[int] = field(default_factory=Counter)
    troubles: list[LinkTrouble] = field(default_factory=list)

    async def rates_hz(self, over_s: float) -> dict[int, float]:
        self.came.clear()
        await asyncio.sleep(over_s)
        return {number: times / over_s for number, times in self.came.items()}

    def hear(self, message: Any) -> None:
        self.came[message.get_msgId()] += 1

    def note(self, news: VehicleNews) -> None:
        if isinstance(news, LinkTrouble):
            self.troubles.append(news)

    @property
    def about(self) -> list[str]:
        return [trouble.about for trouble in self.troubles]


@asynccontextmanager
async def counted(autopilot: MavlinkAutopilot) -> AsyncIterator[Counted]:
    made = Counted(autopilot)
    autopilot.listen(made.note)
    with autopilot.vehicle.listening(made.hear):
        yield made


def tell(
    story: Callable[[Bench, Counted], Awaitable[None]], patch: pytest.MonkeyPatch, air: Air | None = None
) -> None:
    async def live() -> None:
        async with (
            bench(AGILE, air or Air(0.0, seed=1)) as made,
            made.program() as autopilot,
            counted(autopilot) as reports,
        ):
            await story(made, reports)

    run_virtually(live())


def tell_of_px4(story: Callable[[Bench, Counted], Awaitable[None]]) -> None:
    async def live() -> None:
        async with (
            driven(Px4Settings(AGILE.home), AT_ONCE) as (sky, autopilot),
            counted(autopilot) as reports,
        ):
            await story(sky, reports)

    run_virtually(live())


def lowered(made: Bench, rate_hz: int = 1) -> None:
    """A ground station behind the same router sets the rates of all streams, as Mission Planner does."""
    for group in GROUPS:
        made.connection.hear(mavlink.MAVLink_request_data_stream_message(1, 1, group, rate_hz, 1))


def test_from_the_start_each_report_comes_as_often_as_it_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(_made: Bench, reports: Counted) -> None:
        rates = await reports.rates_hz(10.0)
        for number, needed_hz in NEEDED_HZ.items():
            assert rates[number] == pytest.approx(needed_hz, rel=0.05)
        assert rates[HEARTBEAT] >= 9.5
        assert reports.troubles == []

    tell(story, monkeypatch)


@pytest.mark.parametrize("seed", range(3))
def test_a_request_that_the_link_lost_is_made_again_within_seconds(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    async def story(_made: Bench, reports: Counted) -> None:
        await asyncio.sleep(6.0)
        rates = await reports.rates_hz(30.0)
        for number, needed_hz in ARDUCOPTER.streams_hz.items():
            if number not in ARDUCOPTER.sent_at_times:
                assert rates[number] > 0.4 * needed_hz
        assert reports.troubles == []

    tell(story, monkeypatch, Air(0.3, seed=seed))


@played(tell_of_px4)
async def test_px4s_mode_comes_at_each_change_and_says_nothing_of_the_link(
    sky: Bench, reports: Counted
) -> None:
    """It comes twice a second too, whatever is asked, and every other second where it was not asked for."""
    await asyncio.sleep(60.0)
    rates = await reports.rates_hz(10.0)
    assert rates[CURRENT_MODE] == pytest.approx(2.0, rel=0.1)
    assert rates[POSITION] == pytest.approx(10.0, rel=0.1)
    by_itself = mavlink.MAVLink_command_long_message(1, 1, 511, 0, CURRENT_MODE, 0, *(0.0,) * 5)
    sky.connection.hear(by_itself)  # as another program does, or where the request was lost
    assert (await reports.rates_hz(4.0))[CURRENT_MODE] < 1.0
    await asyncio.sleep(4.0)
    assert (await reports.rates_hz(10.0))[CURRENT_MODE] == pytest.approx(2.0, rel=0.1)
    sky.copter.set_mode(Mode.ALTCTL)
    await asyncio.sleep(0.05)
    modes = reports.autopilot.vehicle.telemetry.flown_and_intended_mode
    assert modes == (Mode.ALTCTL, Mode.ALTCTL)
    assert reports.troubles == []


def test_reports_that_come_rarely_during_a_transfer_say_nothing_of_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An ArduPilot that serves parameters to a ground station sends all reports four times as rarely meanwhile."""

    async def story(made: Bench, reports: Counted) -> None:
        await asyncio.sleep(20.0)
        connection, repeat = made.connection, PeerConnection._repeat

        async def rarely_repeat(self: PeerConnection, number: float, interval_s: float) -> None:
            await repeat(self, number, 4 * interval_s)

        monkeypatch.setattr(PeerConnection, "_repeat", rarely_repeat)
        for number in ARDUCOPTER.streams_hz.keys() & connection._streams.keys():
            asked_hz = ARDUCOPTER.streams_hz[number]
            connection._streams[number][1].cancel()
            rarely = asyncio.create_task(connection._repeat(number, 1 / asked_hz))
            connection._streams[number] = 1 / asked_hz, rarely  # it says that its interval is as asked
        for _ in range(400):
            connection.send(made.copter.parameters.at(1))
            await asyncio.sleep(0.1)
        assert reports.troubles == []
        assert (await reports.rates_hz(2.0))[POSITION] <= 3.0
        await asyncio.sleep(60.0)
        assert reports.about == ["capacity"], "without a transfer it is the link"

    tell(story, monkeypatch)


def test_rates_that_a_ground_station_lowered_once_are_back_within_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def story(made: Bench, reports: Counted) -> None:
        await asyncio.sleep(20.0)
        lowered(made)
        assert (await reports.rates_hz(1.0))[POSITION] <= 2.0
        await asyncio.sleep(3.0)
        rates = await reports.rates_hz(10.0)
        assert rates[POSITION] == pytest.approx(10.0, rel=0.1)
        assert rates[mavlink.MAVLINK_MSG_ID_ATTITUDE] == pytest.approx(4.0, rel=0.1)
        assert reports.troubles == []

    tell(story, monkeypatch)


def test_a_ground_station_that_insists_is_told_once_and_asked_against_ever_more_rarely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def story(made: Bench, reports: Counted) -> None:
        await asyncio.sleep(10.0)
        for _ in range(100):
            lowered(made)
            await asyncio.sleep(3.0)
        assert reports.about == ["rates"]
        why = reports.troubles[0].why
        assert (
            "another program on the link, such as a ground station, keeps GLOBAL_POSITION_INT at 1 Hz" in why
        )
        asked_before = made.asked[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL]
        for _ in range(40):
            lowered(made)
            await asyncio.sleep(3.0)
        times = (made.asked[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL] - asked_before) / len(ARDUCOPTER.streams_hz)
        assert 1 <= times <= 4, "once a minute, and what never comes twice"
        assert (await reports.rates_hz(5.0))[HEARTBEAT] >= 10.0, "it is in no group of streams"

    tell(story, monkeypatch)


def test_a_vehicle_that_restarted_is_asked_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(made: Bench, reports: Counted) -> None:
        await asyncio.sleep(5.0)
        for number in ARDUCOPTER.streams_hz:
            interval_us = 1e6 if number == HEARTBEAT else -1
            made.connection.hear(
                mavlink.MAVLink_command_long_message(1, 1, 511, 0, number, interval_us, *(0.0,) * 5)
            )
        await asyncio.sleep(5.0)
        rates = await reports.rates_hz(5.0)
        assert rates[POSITION] == pytest.approx(10.0, rel=0.1)
        assert rates[HEARTBEAT] >= 10.0
        assert reports.troubles == []

    tell(story, monkeypatch)


class Narrow(Air):
    """A link that carries so many bytes a second; the vehicle does not send what has no room, as a real one."""

    def __init__(self, bytes_s: float) -> None:
        super().__init__(0.0, seed=1)
        self._bytes_s = bytes_s
        self._free_s = 0.0
        self.delays_s: list[float] = []

    @property
    def room(self) -> bool:
        """Whether less than half a second's worth waits."""
        return self._free_s - asyncio.get_running_loop().time() < 0.5

    def carry(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        now_s = asyncio.get_running_loop().time()
        self._free_s = max(self._free_s, now_s) + len(packet) / self._bytes_s
        self.delays_s.append(self._free_s - now_s)
        asyncio.get_running_loop().call_at(self._free_s, send, packet)


@pytest.mark.parametrize(
    ("bytes_s", "settles"), [(5760.0, False), (900.0, False), (500.0, True), (350.0, True)]
)
def test_a_link_that_does_not_carry_all_reports_is_asked_for_less(
    monkeypatch: pytest.MonkeyPatch, bytes_s: float, settles: bool
) -> None:
    air = Narrow(bytes_s)

    async def story(_made: Bench, reports: Counted) -> None:
        await asyncio.sleep(60.0)
        assert reports.about == (["capacity"] if settles else [])
        air.delays_s.clear()
        rates = await reports.rates_hz(30.0)
        assert rates[POSITION] > (1.5 if settles else 9.0)
        assert rates[HEARTBEAT] > (1.5 if settles else 9.0)
        assert sorted(air.delays_s)[len(air.delays_s) // 2] < 0.5

    tell(story, monkeypatch, air)


@pytest.mark.parametrize(("firmware", "mode"), [(ARDUCOPTER, HEARTBEAT), (PX4, CURRENT_MODE)])
def test_what_the_latch_needs_comes_at_10_hz_or_more(firmware: Any, mode: int) -> None:
    assert firmware.streams_hz[mode] >= 10.0
    assert firmware.streams_hz[POSITION] >= 10.0
    assert firmware.streams_hz[mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT] >= 4.0
    assert firmware.streams_hz[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] >= 1.0
