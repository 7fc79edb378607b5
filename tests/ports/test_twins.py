"""Two vehicles with one id are never armed, and one vehicle is never taken for two."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AGILE, HOME, Bench, bench
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import LocalFrame, Position
from upwash.errors import AutopilotRefused
from upwash.eventlog.schema import LinkTrouble, PositionDoubted
from upwash.mavlink.packets import PacketReader
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.twins import Twins
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings

CAUTIOUS = FlightSettings()
FRAME = LocalFrame(HOME)
Passes = Callable[[Any], bool]
NO_ANSWERS: Passes = lambda message: message.get_type() != "TIMESYNC"  # noqa: E731


def everything(_message: Any) -> bool:
    return True


def settings(firmware: str, *, east_m: float = 0.0, serial: int = 0) -> VehicleSettings | Px4Settings:
    """A vehicle that may be armed at once, without a serial number if it is 0."""
    home = FRAME.geo(Position(east_m, 0.0))
    if firmware == "px4":
        return Px4Settings(home=home, serial=serial)
    return replace(AGILE, home=home, serial=serial)


class Port:
    """One of several ways from vehicles to a program; `late_s` on the way down."""

    def __init__(self, made: Bench, *, late_s: float = 0.0, passes: Passes = everything) -> None:
        self.made, self.late_s, self.passes = made, late_s, passes
        self.write: Callable[[bytes], None]

    async def open(self, line: Any) -> None:
        def arrive(packet: bytes, address: Any) -> None:
            ((message, _),) = PacketReader().read(packet)
            if self.passes(message):
                asyncio.get_running_loop().call_later(self.late_s, line.datagram_received, packet, address)

        end = SimpleNamespace(datagram_received=arrive, ended=line.ended, write=None)
        await self.made.open(end)
        self.write = end.write


def merged(*ports: Port) -> Any:
    """One link that passes what any of the ports says, and tells each port what the program says."""

    async def open_line(line: Any) -> None:
        for port in ports:
            await port.open(line)

        def write(packet: bytes) -> None:
            for port in ports:
                port.write(packet)

        line.write = write

    return open_line


@contextlib.asynccontextmanager
async def connected(*ports: Port, **named: Any) -> AsyncIterator[MavlinkAutopilot]:
    autopilot = await connect_autopilot(
        merged(*ports), frame=FRAME, ground_speed_m_s=5.0, settings=CAUTIOUS, **named
    )
    try:
        yield autopilot
    finally:
        await autopilot.close()


@contextlib.asynccontextmanager
async def two(
    after_s: float, *, firmware: str = "arducopter", east_m: float = 89.0, serials: tuple[int, int] = (0, 0)
) -> AsyncIterator[tuple[Bench, Bench]]:
    """Two vehicles that are switched on one after the other."""
    async with bench(settings(firmware, serial=serials[0])) as first:
        await asyncio.sleep(after_s)
        async with bench(settings(firmware, east_m=east_m, serial=serials[1])) as second:
            await asyncio.sleep(5.0)  # both have booted
            yield first, second


def never_armed(*vehicles: Bench) -> bool:
    return not any(mavlink.MAV_CMD_COMPONENT_ARM_DISARM in made.commands() for made in vehicles)


# --- two vehicles -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
@pytest.mark.parametrize("passes", [everything, NO_ANSWERS])
@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.3, 1.0, 1.9, 2.5, 3.0, 8.0, 60.0])
@pytest.mark.virtual
async def test_two_that_are_started_together_are_refused(
    after_s: float, passes: Passes, firmware: str
) -> None:
    async with two(after_s, firmware=firmware) as vehicles:
        with pytest.raises(AutopilotRefused, match=r"two vehicles with system 1 are on the link \(two "):
            async with connected(*(Port(made, passes=passes) for made in vehicles)) as autopilot:
                await claim_and_arm(autopilot)
        assert never_armed(*vehicles)


@pytest.mark.parametrize("east_m", [0.8, 1.5, 3.0])
@pytest.mark.virtual
async def test_two_that_stand_side_by_side_are_refused_by_their_places(east_m: float) -> None:
    async with two(0.0, east_m=east_m) as vehicles:
        with pytest.raises(AutopilotRefused, match=rf"two places, {east_m:.1f} m apart"):
            async with connected(*map(Port, vehicles)) as autopilot:
                await claim_and_arm(autopilot)
        assert never_armed(*vehicles)


@pytest.mark.virtual
async def test_two_at_one_place_are_refused_by_clocks_a_tenth_of_a_second_apart() -> None:
    async with two(0.1, east_m=0.0) as vehicles:
        with pytest.raises(AutopilotRefused, match=r"two clocks since boot, 0\.1 s apart"):
            async with connected(*map(Port, vehicles), system=1) as autopilot:
                await claim_and_arm(autopilot)


@pytest.mark.virtual
async def test_each_stand_in_has_a_serial_number_of_its_own() -> None:
    first, second = (VehicleSettings(home=HOME).serial for _ in range(2))
    assert first != second
    async with two(0.0, east_m=0.0, serials=(first, second)) as vehicles:
        with pytest.raises(AutopilotRefused, match="two serial numbers of hardware"):
            async with connected(*map(Port, vehicles)) as autopilot:
                await claim_and_arm(autopilot)


@pytest.mark.virtual
async def test_a_second_one_that_joins_after_arming_is_never_taken_off_with() -> None:
    async with two(1.0) as (first, second):
        joined = False
        late = Port(second, passes=lambda _: joined)
        async with connected(Port(first), late) as autopilot:
            await claim_and_arm(autopilot)
            joined = True
            with pytest.raises(AutopilotRefused, match="two vehicles with system 1"):
                await asyncio.sleep(4.0)
                await autopilot.takeoff(5.0)
            assert mavlink.MAV_CMD_NAV_TAKEOFF not in [*first.commands(), *second.commands()]


@pytest.mark.virtual
async def test_a_second_one_that_is_seen_in_the_air_ends_the_leg_and_both_return() -> None:
    async with two(1.0) as (first, second):
        joined = False
        late = Port(second, passes=lambda _: joined)
        news: list[Any] = []
        async with connected(Port(first), late) as autopilot:
            autopilot.listen(news.append)
            await take_off(autopilot)
            leg = asyncio.create_task(autopilot.goto(Position(400.0, 0.0, 5.0)))
            await asyncio.sleep(3.0)
            joined, begun_s = True, first.now_s
            with pytest.raises(AutopilotRefused, match="two vehicles with system 1"):
                await leg
            assert first.now_s - begun_s < 5.0
            assert not autopilot.position_is_sure, "it is that of either"
            await autopilot.return_home_and_land()
            assert not first.copter.flying(first.now_s)
            assert not second.copter.flying(second.now_s)
        assert [each.about for each in news if isinstance(each, LinkTrouble)] == ["same-id"]
        assert sum(isinstance(each, PositionDoubted) for each in news) < 10, "places of two are no jumps"


@pytest.mark.virtual
async def test_two_are_not_called_a_bridge() -> None:
    async with two(0.3) as vehicles:
        news: list[Any] = []
        with pytest.raises(AutopilotRefused):
            async with connected(*(Port(made, passes=NO_ANSWERS) for made in vehicles)) as autopilot:
                autopilot.listen(news.append)
                await claim_and_arm(autopilot)
        assert "numbers" not in [each.about for each in news if isinstance(each, LinkTrouble)]


# --- one vehicle --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["arducopter", "px4"])
@pytest.mark.parametrize("late_s", [0.05, 0.7, 1.8])
@pytest.mark.virtual
async def test_one_that_is_heard_by_two_ports_is_armed(late_s: float, firmware: str) -> None:
    async with bench(settings(firmware)) as made:
        await asyncio.sleep(5.0)
        async with connected(Port(made), Port(made, late_s=late_s)) as autopilot:
            await claim_and_arm(autopilot)
            await asyncio.sleep(5.0)
            assert autopilot.vehicle.identity.two_with_one_id == ""


@pytest.mark.parametrize("late_s", [0.0, 0.3, 1.8])
def test_places_of_a_fast_vehicle_that_come_by_two_links_are_of_one(late_s: float) -> None:
    def place(boot_s: float) -> Any:  # a circle of 40 m at 15 m/s
        angle, speed_m_s = 15.0 * boot_s / 40.0, 15.0
        there = Position(40 * math.cos(angle), 40 * math.sin(angle), 20.0)
        return at(boot_s, there, (-speed_m_s * math.sin(angle), speed_m_s * math.cos(angle)))

    fast = [(tick / 10, place(tick / 10)) for tick in range(600)]
    slow = [(heard_s + late_s, place(heard_s + 0.03)) for heard_s, _ in fast]
    assert shown_by(sorted([*fast, *slow], key=lambda each: each[0])) == ""


def at(boot_s: float, place: Position, velocity_m_s: tuple[float, float] = (0.0, 0.0)) -> Any:
    geo = FRAME.geo(place)
    return mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3),
        round(geo.latitude_deg * 1e7),
        round(geo.longitude_deg * 1e7),
        round(place.altitude_m * 1e3),
        0,
        round(velocity_m_s[1] * 100),
        round(velocity_m_s[0] * 100),
        0,
        0,
    )


def shown_by(said: Iterable[tuple[float, Any]]) -> str:
    twins = Twins()
    for heard_s, message in said:
        twins.take(message, heard_s)
    return twins.evidence


def test_a_glitch_and_its_end_are_of_one_vehicle() -> None:
    def place(tick: int) -> Position:
        return Position(0.0, 56.0 if 100 <= tick < 300 or tick in (50, 400) else 0.0)

    assert shown_by((tick / 10, at(tick / 10, place(tick))) for tick in range(600)) == ""


def test_a_filter_that_hops_each_second_is_of_one_vehicle() -> None:
    hops = ((tick / 10, at(tick / 10, Position(4.0 * (tick // 10 % 2), 0.0))) for tick in range(600))
    assert shown_by(hops) == ""


def test_a_restart_at_another_place_is_of_one_vehicle() -> None:
    before = [(60 + tick / 10, at(60 + tick / 10, Position(0.0, 0.0))) for tick in range(100)]
    after = [(75 + tick / 10, at(tick / 10, Position(80.0, 0.0))) for tick in range(1000)]
    assert shown_by([*before, *after]) == ""


def test_no_place_yet_is_no_other_place() -> None:
    nowhere = mavlink.MAVLink_global_position_int_message
    said = [
        (
            tick / 10,
            nowhere(tick * 100, 0, 0, 0, 0, 0, 0, 0, 0) if tick % 2 else at(tick / 10, Position(0, 0)),
        )
        for tick in range(100)
    ]
    assert shown_by(said) == ""


def test_a_time_of_1970_on_is_no_clock_since_boot() -> None:
    twins = Twins()
    for second in range(20):
        question = twins.question(float(second))
        for stamp_ns in ((10 + second) * 10**9, 1_795_339_393 * 10**9):
            twins.take(mavlink.MAVLink_timesync_message(stamp_ns, question.ts1), second + 0.01)
    assert twins.evidence == ""


@pytest.mark.parametrize(("speed", "apart_s", "shown"), [(1, 0.04, False), (1, 0.2, True), (20, 0.9, False)])
def test_answers_may_be_as_far_apart_as_the_clock_runs_between_question_and_answer(
    speed: int, apart_s: float, *, shown: bool
) -> None:
    twins = Twins()
    for second in range(10):
        question = twins.question(float(second))
        for late_s in (0.0, apart_s):
            stamp_ns = round((5 + second * speed + late_s) * 1e9)
            twins.take(mavlink.MAVLink_timesync_message(stamp_ns, question.ts1), second + 0.05)
    assert bool(twins.evidence) == shown


def test_answers_to_others_questions_say_nothing() -> None:
    twins = Twins()
    for second in range(10):
        twins.question(float(second))
        for stamp_s in (5, 90):
            twins.take(mavlink.MAVLink_timesync_message((stamp_s + second) * 10**9, 77), second + 0.05)
    assert twins.evidence == ""


def beat(mode: int, *, armed: bool = False) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 81 | 128 * armed, mode, 4, 3)


@pytest.mark.parametrize(
    ("each_s", "until_s", "shown"),
    [(0.1, 4.0, False), (0.1, 6.0, True), (1.0, 8.0, True), (2.0, 60.0, False)],
)
def test_states_that_change_to_and_fro_are_of_two_unless_a_pilot_or_a_late_copy_explains_them(
    each_s: float, until_s: float, *, shown: bool
) -> None:
    times = range(round(until_s / each_s))
    assert bool(shown_by((number * each_s, beat(4 * (number % 2))) for number in times)) == shown


def test_homes_in_turns_are_of_two_and_a_home_that_moves_is_of_one() -> None:
    def home(latitude_e7: int) -> Any:
        return mavlink.MAVLink_home_position_message(latitude_e7, 0, 0, 0, 0, 0, [0] * 4, 0, 0, 0)

    assert "two homes" in shown_by((number / 2, home(5 + number % 2)) for number in range(20))
    assert shown_by((number / 2, home(number)) for number in range(40)) == ""


@pytest.mark.parametrize(
    ("times", "twins"),
    [
        ([(9_000, 0.0), (6_999, 0.0), (9_000, 0.5), (6_999, 0.5), (9_000, 1.0), (6_999, 1.0)], True),
        ([(9_000, 0.0), (7_000, 0.0), (9_000, 0.5), (7_000, 0.5), (9_000, 1.0), (7_000, 1.0)], False),
        ([(9_000, 0.0), (6_999, 0.0), (9_000, 0.5), (6_999, 0.5)], False),
        ([(9_000, 7.0), (6_000, 7.0), (9_000, 9.0), (6_000, 9.0), (9_000, 17.0), (6_000, 17.0)], True),
        ([*[(9_000, 7.0), (6_000, 7.0)] * 2, (9_000, 17.0625), (6_000, 17.0625)], False),
        ([(1_000, 5.0), *[(101_000, 15.0), (81_000, 15.0)] * 3], False),  # a clock that is ten times as fast
        ([(1_000, 5.0), *[(101_000, 15.0), (80_999, 15.0)] * 3], True),
        ([(0, 5.0), *[(9_000, 5.5), (6_000, 5.5)] * 3], False),  # less than a second says nothing of its speed
    ],
)  # fmt: skip
def test_a_clock_that_goes_back_three_times_in_ten_seconds_is_of_two_vehicles(
    times: list[tuple[int, float]], *, twins: bool
) -> None:
    both = Twins()
    for boot_ms, now_s in times:
        assert both.evidence == ""
        both.take(mavlink.MAVLink_attitude_message(boot_ms, *(0.0,) * 6), now_s)
    assert both.evidence == ("two clocks since boot" if twins else "")
