"""Files, parameters and fences from somebody who answers in the vehicle's name, on virtual time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import Bench, driven
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotError
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.ftp import Opcode, Packet, read_packet
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.ftp import MOST_FILE_BYTES, FileClient
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings

HOME = GeoPosition(39.3666, 22.9507)
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
STAY_IN = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
KEEP_OUT = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
CIRCLE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
ARDUCOPTER = VehicleSettings(
    HOME, home_altitude_m=488.0, armable_after_s=0.0, parameters={"FENCE_ENABLE": 1, "FENCE_TYPE": 4}
)
PX4 = Px4Settings(HOME, armable_after_s=0.0, parameters={"COM_OBL_RC_ACT": 3.0, "GF_ACTION": 3.0})
Forger = Callable[[Any], Iterable[Any] | None]
"""What it says instead of the vehicle to a question; None: the vehicle answers."""


def forged(
    flight: Callable[[Bench, MavlinkAutopilot], Awaitable[None]],
    forger: Forger,
    settings: VehicleSettings | Px4Settings = ARDUCOPTER,
) -> None:
    async def flown() -> None:
        async with driven(settings) as (sky, autopilot):
            hear = sky.connection.hear

            def answer(question: Any) -> None:
                answers = forger(question)
                if answers is None:
                    hear(question)
                for each in answers or ():
                    sky.connection.send(each)

            sky.connection.hear = answer  # type: ignore[method-assign,assignment]
            await flight(sky, autopilot)

    run_virtually(flown())


# --- files --------------------------------------------------------------------------------------------------


def files(answer: Callable[[Packet], Iterable[Packet]]) -> Forger:
    def forger(question: Any) -> Iterable[Any] | None:
        if question.get_type() != "FILE_TRANSFER_PROTOCOL":
            return None
        request = read_packet(bytes(question.payload))
        assert request is not None
        return [
            mavlink.MAVLink_file_transfer_protocol_message(0, 1, 191, list(each.payload()))
            for each in answer(request)
        ]

    return forger


def ack(
    request: Packet, data: bytes = b"", *, session: int | None = None, offset: int | None = None
) -> Packet:
    return Packet(
        (request.number + 1) % 2**16,
        request.session if session is None else session,
        Opcode.ACK,
        request.opcode,
        request.offset if offset is None else offset,
        data,
    )


QUESTION = Packet(0, 0, Opcode.LIST_DIRECTORY)


def end(request: Packet) -> Packet:
    return Packet((request.number + 1) % 2**16, 0, Opcode.NAK, request.opcode, request.offset, bytes([6]))


@pytest.mark.parametrize("part", [b"x" * 20, b"x" * 239])
def test_a_file_without_end_is_refused(part: bytes) -> None:
    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        with pytest.raises(AutopilotError, match=f"longer than {MOST_FILE_BYTES}"):
            await FileClient(autopilot.vehicle).read("a")

    forged(flight, files(lambda request: [ack(request, part if request.opcode == Opcode.READ_FILE else b"")]))


def test_a_file_that_comes_too_slowly_ends_in_an_error() -> None:
    asked: dict[int, int] = {}

    def answer(request: Packet) -> list[Packet]:
        asked[request.number] = asked.get(request.number, 0) + 1
        is_slow = request.opcode == Opcode.READ_FILE and asked[request.number] < 12
        return [] if is_slow else [ack(request, b"x")]

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        with pytest.raises(AutopilotError):
            async with asyncio.timeout(1_000.0):
                await FileClient(autopilot.vehicle).read("a")

    forged(flight, files(answer))


def test_parts_from_elsewhere_are_no_part_of_the_file() -> None:
    def answer(request: Packet) -> list[Packet]:
        if request.opcode != Opcode.READ_FILE:
            return [ack(request, session=3)]
        true = ack(request, b"true") if request.offset == 0 else end(request)
        return [
            ack(request, b"lie", session=9),
            ack(request, b"lie", offset=request.offset + 1),
            ack(request, b"lie", offset=2**32 - 1),
            Packet(request.number, 3, Opcode.ACK, Opcode.READ_FILE, request.offset, b"lie"),
            Packet(
                (request.number + 1) % 2**16, 3, Opcode.ACK, Opcode.LIST_DIRECTORY, request.offset, b"lie"
            ),
            true,
        ]

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        assert await FileClient(autopilot.vehicle).read("a") == b"true"

    forged(flight, files(answer))


@pytest.mark.parametrize(
    "answer",
    [
        lambda request: [Packet((request.number + 1) % 2**16, 0, Opcode.NAK, request.opcode)],
        lambda request: [
            Packet((request.number + 1) % 2**16, 0, Opcode.NAK, request.opcode, 0, b"\xff" * 239)
        ],
        lambda request: [Packet((request.number + 1) % 2**16, 0, 77, request.opcode)],
        lambda request: [ack(request, b"D" * 239)] * 2_000,
        lambda request: [],
    ],
    ids=["no reason", "an unknown reason", "an unknown answer", "a flood of listings", "silence"],
)
def test_a_directory_is_there_or_an_error_says_why_not(answer: Callable[[Packet], list[Packet]]) -> None:
    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        try:
            is_there = await FileClient(autopilot.vehicle).has_directory("APM")
            assert is_there == (next(iter(answer(QUESTION))).opcode == Opcode.ACK)
        except AutopilotError as error:
            assert str(error)

    forged(flight, files(answer))


# --- parameters ---------------------------------------------------------------------------------------------


def parameters(value: float, kind: int, *, flood: int = 0) -> Forger:
    def forger(question: Any) -> Iterable[Any] | None:
        if question.get_type() != "PARAM_REQUEST_READ":
            return None
        name = question.param_id.encode()
        others = [
            mavlink.MAVLink_param_value_message(odd, value, kind, 65_535, 65_535)
            for odd in (b"\xff" * 16, b"", b"\x00A", b"A\x1b[2J")
        ]
        return [*others * flood, mavlink.MAVLink_param_value_message(name, value, kind, 65_535, 65_535)]

    return forger


ODD = [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -1.0, 65_535.0, 0.5]


@pytest.mark.parametrize("kind", [0, mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32, 255])
@pytest.mark.parametrize("value", ODD)
@pytest.mark.parametrize("settings", [ARDUCOPTER, PX4], ids=["ArduCopter", "PX4"])
def test_parameters_of_any_value_end_in_facts_or_in_an_error(
    value: float, kind: int, settings: VehicleSettings | Px4Settings
) -> None:
    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        news: list[VehicleNews] = []
        autopilot.listen(news.append)
        try:
            await autopilot.inspect()
            limits = await autopilot.limits()
        except AutopilotError:
            return
        facts = [autopilot.energy.return_altitude_m, limits.margin_m, limits.highest_m, limits.lowest_m]
        assert all(math.isfinite(fact) for fact in facts if fact is not None)
        way = autopilot.energy.way_home
        assert way is not None
        assert 0 < way.speed_m_s <= 100 and 0 < way.descent_m_s <= 100 and 0 <= way.altitude_m <= 10_000
        if not math.isfinite(value):
            told = [each for each in news if isinstance(each, VehicleSetting) and each.value is None]
            assert told or settings is PX4

    forged(flight, parameters(value, kind), settings)


@played(forged, parameters(5.0, 9, flood=200))
async def test_a_flood_of_parameters_that_nobody_asked_for_is_passed_over(
    sky: Bench, autopilot: MavlinkAutopilot
) -> None:
    begun_s = sky.now_s
    await autopilot.learn()
    assert sky.now_s - begun_s < 5.0
    assert autopilot.energy.return_altitude_m == pytest.approx(0.05)


# --- fences -------------------------------------------------------------------------------------------------


def item(
    command: int, size: float, x: int = 393_666_000, y: int = 229_507_000
) -> tuple[int, float, int, int]:
    return command, size, x, y


def fence(*items: tuple[int, float, int, int], count: int | None = None) -> Forger:
    def forger(question: Any) -> Iterable[Any] | None:
        if question.get_type() == "MISSION_REQUEST_LIST":
            return [
                mavlink.MAVLink_mission_count_message(1, 191, len(items) if count is None else count, FENCE)
            ]
        if question.get_type() == "MISSION_REQUEST_INT" and question.seq < len(items):
            command, size, x, y = items[question.seq]
            return [
                mavlink.MAVLink_mission_item_int_message(
                    1, 191, question.seq, 0, command, 0, 1, size, 0, 0, 0, x, y, 0, FENCE
                )
            ]
        return None

    return forger


NONSENSE = {
    "a polygon of no number": fence(*[item(STAY_IN, math.nan)] * 4),
    "an infinite polygon": fence(*[item(STAY_IN, math.inf)] * 4),
    "a polygon of two corners": fence(*[item(STAY_IN, 2)] * 2),
    "a polygon that ends early": fence(*[item(STAY_IN, 4)] * 3),
    "a polygon of two minds": fence(*[item(STAY_IN, 4)] * 2, *[item(KEEP_OUT, 4)] * 2),
    "a polygon of two sizes": fence(*[item(STAY_IN, 4)] * 2, *[item(STAY_IN, 3)] * 2),
    "a corner beyond the pole": fence(*[item(STAY_IN, 3)] * 2, item(STAY_IN, 3, x=2**31 - 1)),
    "a corner beyond the date line": fence(*[item(STAY_IN, 3)] * 2, item(STAY_IN, 3, y=-(2**31))),
    "a circle of no radius": fence(item(CIRCLE, math.nan)),
    "an infinite circle": fence(item(CIRCLE, math.inf)),
    "a circle of less than nothing": fence(item(CIRCLE, -1.0)),
    "65,535 items": fence(count=65_535),
    "items that never come": fence(count=3),
}


@pytest.mark.parametrize("forger", NONSENSE.values(), ids=NONSENSE)
@pytest.mark.parametrize("settings", [ARDUCOPTER, PX4], ids=["ArduCopter", "PX4"])
def test_a_fence_that_makes_no_sense_is_not_taken_for_none(
    forger: Forger, settings: VehicleSettings | Px4Settings
) -> None:
    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        with pytest.raises(AutopilotError, match="fence"):
            await autopilot.limits()

    forged(flight, forger, settings)


def test_items_that_are_no_areas_may_hold_anything() -> None:
    point = item(mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT, math.nan, x=2**31 - 1)

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        limits = await autopilot.limits()
        assert len(limits.fences) == 1

    forged(flight, fence(point, item(CIRCLE, 50.0)))


# --- others -------------------------------------------------------------------------------------------------


def test_times_of_anybody_move_no_deadline() -> None:
    """TIMESYNC and SYSTEM_TIME: the driver's time is this computer's."""

    async def flight(sky: Bench, autopilot: MavlinkAutopilot) -> None:
        await take_off(autopilot)
        begun_s = sky.now_s
        for number in range(200):
            sky.connection.send(mavlink.MAVLink_timesync_message(2**62 * (-1) ** number, -(2**62)))
            sky.connection.send(
                mavlink.MAVLink_system_time_message((2**63) * (number % 2), round(begun_s * 1e3))
            )
            await asyncio.sleep(0.01)
        assert autopilot.vehicle.linked
        await autopilot.return_home_and_land()
        assert sky.now_s - begun_s < 120.0

    forged(flight, lambda _: None, replace(ARDUCOPTER, parameters={}))


@pytest.mark.parametrize("boot_ms", [0, 2**32 - 1])
@played(forged, lambda _: None, replace(ARDUCOPTER, parameters={}))
async def test_one_time_since_boot_that_cannot_be_true_is_no_restart(
    sky: Bench, autopilot: MavlinkAutopilot, *, boot_ms: int
) -> None:
    await take_off(autopilot)
    sky.connection.send(mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0))
    await asyncio.sleep(5.0)
    assert autopilot.control.is_ours
    await autopilot.return_home_and_land()
