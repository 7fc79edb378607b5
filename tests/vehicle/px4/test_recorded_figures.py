"""The stand-in PX4 beside recorded flights of a real one: every figure within 5 % of the recordings' median.

data/figures.csv and data/profiles.csv hold what `bench/px4_figures.py` read out of 16 flights of a PX4 1.16.1 in its
own simulation (SIH, quadrotor, no wind, default parameters).
"""

from __future__ import annotations

import asyncio
import csv
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from tests.played import played
from tests.vehicle.px4.client import SETTINGS, Px4Client, talk

from upwash.core.geo import Position, ground_distance_m
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.connection import StandIn
from upwash.vehicle.body.copter import FaultKind

DATA = Path(__file__).parent / "data"
RECORDED = {
    row["figure"]: float(row["median"])
    for row in csv.DictReader((DATA / "figures.csv").read_text(encoding="utf-8").splitlines())
}
PROFILES = list(csv.DictReader((DATA / "profiles.csv").read_text(encoding="utf-8").splitlines()))
SPEEDS_M_S = {"reposition_4": 4.0, "reposition_8": 8.0, "offboard_4": 4.0, "offboard_default": 12.0}
GRID = [(0, 0), (40, 0), (80, 0), (120, 0), (120, 40), (80, 40), (40, 40), (0, 40)]
WITHIN = 0.05


def agrees(figure: str, value: float) -> None:
    assert value == pytest.approx(RECORDED[figure], rel=WITHIN), figure


def middle(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


async def go(client: Px4Client, kind: str, place: Position) -> None:
    if kind.startswith("reposition"):
        assert await client.reposition(place, speed_m_s=SPEEDS_M_S[kind]) == 0
    else:
        client.setpoint(place)


async def near(client: Px4Client, place: Position, distance_m: float) -> None:
    await client.until(lambda: ground_distance_m(client.here(), place) < distance_m)


async def arrive(client: Px4Client, place: Position) -> None:
    await client.until(lambda: ground_distance_m(client.here(), place) < 1 and client.speed_m_s() < 0.5)


@pytest.mark.parametrize("kind", SPEEDS_M_S)
@played(talk)
async def test_a_leg_of_40_m_takes_as_long_and_is_as_fast(client: Px4Client, *, kind: str) -> None:
    await client.take_off()
    start = Position(0.0, 0.0, 10.0)
    await go(client, kind, start)
    if kind == "offboard_4":
        assert await client.set_parameter("MPC_XY_VEL_MAX", 4.0) == 4.0
    if kind.startswith("offboard"):
        await asyncio.sleep(1.0)
        assert await client.mode(Mode.OFFBOARD) == [0, 0]
    await asyncio.sleep(3.0)
    took_s, halves_s, tops_m_s = [], [], []
    for before, after in pairwise(GRID):
        place, begun_s = Position(*after, 10.0), client.now_s()
        await go(client, kind, place)
        known = len(client.heard)
        await near(client, place, 20.0)
        halves_s.append(client.now_s() - begun_s)
        await arrive(client, place)
        took_s.append(client.now_s() - begun_s)
        moved = [each for each in client.heard[known:] if each.get_type() == "GLOBAL_POSITION_INT"]
        tops_m_s.append(max(math.hypot(each.vx, each.vy) for each in moved) / 100)
        await asyncio.sleep(1.0)
        assert ground_distance_m(Position(*before), Position(*after)) == 40
    agrees(f"leg_{kind}_s", middle(took_s))
    agrees(f"half_leg_{kind}_s", middle(halves_s))
    agrees(f"top_{kind}_m_s", middle(tops_m_s))


@pytest.mark.parametrize("kind", SPEEDS_M_S)
@played(talk)
async def test_a_leg_runs_along_the_recorded_profile(
    client: Px4Client, vehicle: StandIn, *, kind: str
) -> None:
    await client.take_off()
    await go(client, kind, Position(0.0, 0.0, 10.0))
    if kind == "offboard_4":
        await client.set_parameter("MPC_XY_VEL_MAX", 4.0)
    if kind.startswith("offboard"):
        await asyncio.sleep(1.0)
        await client.mode(Mode.OFFBOARD)
    await asyncio.sleep(15.0)
    begun_s, start_m = vehicle.now_s(), client.here().east_m
    await go(client, kind, Position(40.0, 0.0, 10.0))
    off_m_s, off_m = [], []
    rows = [row for row in PROFILES if row["kind"] == kind]
    start_m -= float(rows[0]["way_m"])  # it began where its last overshoot had left it
    for row in rows:
        await asyncio.sleep(max(0.0, begun_s + float(row["time_s"]) - vehicle.now_s()))
        off_m_s.append(client.all("GLOBAL_POSITION_INT")[-1].vy / 100 - float(row["speed_m_s"]))
        off_m.append(client.here().east_m - start_m - float(row["way_m"]))
    assert math.sqrt(sum(off**2 for off in off_m_s) / len(off_m_s)) < 0.1 * SPEEDS_M_S[kind]
    assert math.sqrt(sum(off**2 for off in off_m) / len(off_m)) < 1.5


@played(talk)
async def test_take_off_return_and_landing_take_as_long(client: Px4Client) -> None:
    await client.quietly()
    await client.armable()
    assert await client.arm() == 0
    begun_s = client.now_s()
    await client.long(22, math.nan, 0, 0, math.nan, math.nan, math.nan, await client.home_altitude_m() + 10)
    await client.until(lambda: client.here().altitude_m > 0.3)
    agrees("lifts_s", client.now_s() - begun_s)
    agrees("takeoff_s", await client.in_mode(Mode.LOITER) - begun_s)
    agrees("takeoff_ends_m", client.here().altitude_m)
    for place, figure in (Position(80.0, 0.0, 10.0), "80"), (Position(120.0, 80.0, 10.0), "144"):
        if figure == "144":
            await client.disarmed()
            await client.take_off()
        await client.reposition(place, speed_m_s=8.0)
        await arrive(client, place)
        await asyncio.sleep(4.0)
        begun_s = client.now_s()
        await client.mode(Mode.RTL)
        lands_s = await client.hears("landing at the destination")
        landed_s = await client.in_state(1)
        agrees(f"return_{figure}_m_s", landed_s - begun_s)
        agrees("landing_from_30_m_s", landed_s - lands_s)
        agrees("disarms_s", await client.hears("disarmed by landing") - await client.says("landing detected"))


def timed(scenario: Callable[[Px4Client, StandIn], Awaitable[None]], **parameters: float) -> None:
    talk(scenario, replace(SETTINGS, parameters=parameters))


@played(timed)
async def test_a_landing_from_10_m_takes_as_long(client: Px4Client) -> None:
    await client.take_off()
    await asyncio.sleep(5.0)
    begun_s = client.now_s()
    assert await client.mode(Mode.LAND) == [0, 0]
    agrees("landing_from_10_m_s", await client.in_state(1) - begun_s)


@played(timed)
async def test_armed_and_left_alone_it_disarms_when_it_was_seen_to(client: Px4Client) -> None:
    await client.armable()
    await client.arm()
    begun_s = client.now_s()
    agrees("disarms_unflown_s", await client.hears("auto preflight disarming") - begun_s)


async def offboard_at_full_speed(client: Px4Client) -> float:
    """Flies east in OFFBOARD and falls silent; returns when."""
    await client.take_off()
    client.as_companion()
    client.setpoint(Position(0.0, 0.0, 10.0))
    await asyncio.sleep(3.0)
    assert await client.mode(Mode.OFFBOARD) == [0, 0]
    client.setpoint(Position(500.0, 0.0, 10.0))
    await client.until(lambda: client.speed_m_s() > 9.4)
    client.stop("setpoints", "companion")
    return client.now_s()


@played(timed, COM_OBL_RC_ACT=5)
async def test_silence_in_offboard_is_noticed_and_hold_stops_as_far_away(client: Px4Client) -> None:
    silent_s = await offboard_at_full_speed(client)
    lost_s = await client.hears("switching to Hold") - silent_s
    assert lost_s == pytest.approx(RECORDED["offboard_lost_s"], abs=0.16)  # a setpoint's age at the silence
    left = client.here()
    await client.until(lambda: client.speed_m_s() < 0.25)
    agrees("holds_from_9_6_m_s_within_m", ground_distance_m(left, client.here()))
    silent_for_s = await client.says("companion computer lost") - silent_s
    assert silent_for_s == pytest.approx(RECORDED["companion_lost_s"], abs=1.0)  # a heartbeat's age


@played(timed)
async def test_without_pilot_and_setpoints_it_sinks_as_long(client: Px4Client) -> None:
    await offboard_at_full_speed(client)
    begun_s = await client.in_mode(Mode.POSCTL)
    agrees("sinks_from_10_m_s", await client.in_state(1) - begun_s)
    await client.disarmed()
    assert client.heartbeat() == (17, Mode.OFFBOARD, 0)


@played(timed)
async def test_without_gps_it_descends_when_it_was_seen_to(client: Px4Client, vehicle: StandIn) -> None:
    await client.take_off()
    await asyncio.sleep(5.0)
    vehicle.firmware.copter.fail(FaultKind.GPS, vehicle.now_s())
    begun_s = client.now_s()
    descends_s = await client.in_mode(Mode.LAND)
    agrees("gps_lost_descends_s", descends_s - begun_s)
    agrees("descends_from_10_m_s", await client.in_state(1) - descends_s)


@played(timed, NAV_DLL_ACT=2)
async def test_a_lost_ground_station_is_answered_when_it_was_seen_to(client: Px4Client) -> None:
    client.as_ground_station()
    await client.take_off()
    await client.reposition(Position(200.0, 0.0, 10.0))
    await asyncio.sleep(5.0)
    client.stop("ground station")
    begun_s = client.now_s()
    lost_s = await client.hears("ground station lost") - begun_s
    returns_s = await client.in_mode(Mode.RTL) - begun_s
    assert lost_s == pytest.approx(RECORDED["ground_station_lost_s"], abs=1.0)  # a heartbeat's age
    assert returns_s - lost_s == pytest.approx(5.0, abs=0.2)
    assert returns_s == pytest.approx(RECORDED["ground_station_lost_returns_s"], abs=1.0)


@played(timed)
async def test_a_pilot_s_mode_stops_as_far_away(client: Px4Client) -> None:
    client.sticks()
    await client.take_off()
    await client.reposition(Position(120.0, 0.0, 10.0))
    await client.until(lambda: client.speed_m_s() > 3.3)
    left = client.here()
    assert await client.mode(Mode.POSCTL) == [0, 0]
    await asyncio.sleep(0.5)
    await client.until(lambda: client.speed_m_s() < 0.25)
    agrees("stops_from_3_3_m_s_within_m", ground_distance_m(left, client.here()))
