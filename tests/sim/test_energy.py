"""What a simulated drone draws, by how it moves, computes and transfers."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.played import played

from upwash.config.world import EnergyConfig
from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.control import Control
from upwash.eventlog.schema import EnergyUsed
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.energy import EnergyMeter, Rotors
from upwash.sim.loop import run_virtually
from upwash.sim.vehicle import FlightModel, Plain
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.kinematics import Phase, leg

PAPER = Rotors(EnergyConfig())
PLAIN = Plain(acceleration_m_s2=1.0, takeoff_s=10.0, return_and_land_s=16.0)
SPEEDS = st.floats(0.0, 40.0)


def as_printed_w(speed_m_s: float) -> float:
    """The paper's equation, with the numbers of its example."""
    disc_m2, density_kg_m3, solidity = 0.503, 1.225, 0.05
    blades_w = 0.012 / 8 * density_kg_m3 * solidity * disc_m2 * 300**3 * 0.4**3
    induced_w = 1.1 * 20**1.5 / math.sqrt(2 * density_kg_m3 * disc_m2)
    ratio = speed_m_s**2 / (2 * 4.03**2)
    return (
        blades_w * (1 + 3 * speed_m_s**2 / 120**2)
        + induced_w * math.sqrt(math.sqrt(1 + ratio**2) - ratio)
        + 0.5 * 0.6 * density_kg_m3 * solidity * disc_m2 * speed_m_s**3
    )


@given(SPEEDS)
def test_level_flight_draws_what_the_paper_says(speed_m_s: float) -> None:
    assert PAPER.power_w(Velocity(speed_m_s)) == pytest.approx(as_printed_w(speed_m_s), rel=2e-3)


def test_the_least_is_drawn_at_the_papers_speed_of_longest_endurance() -> None:
    least_m_s = min((tenths / 10 for tenths in range(300)), key=lambda each: PAPER.power_w(Velocity(each)))
    assert least_m_s == pytest.approx(10.2, abs=0.2)


@given(SPEEDS, st.floats(0.01, 5.0))
def test_climbing_draws_more_and_descending_no_less(speed_m_s: float, climb_m_s: float) -> None:
    level_w = PAPER.power_w(Velocity(speed_m_s))
    assert PAPER.power_w(Velocity(speed_m_s, 0.0, climb_m_s)) > level_w > 0
    assert PAPER.power_w(Velocity(speed_m_s, 0.0, -climb_m_s)) == level_w


def test_a_climb_gives_the_weight_its_height() -> None:
    climb_m_s, weight_n = 2.0, 20.0
    extra_w = PAPER.power_w(Velocity(up_m_s=climb_m_s)) - PAPER.hover_w
    assert weight_n * climb_m_s / 2 < extra_w < 1.1 * weight_n * climb_m_s


@given(st.floats(1.0, 500.0), st.floats(0.5, 20.0), st.floats(0.0, 1.0))
def test_a_phase_draws_the_integral_of_its_power(length_m: float, cruise_m_s: float, share: float) -> None:
    for phase in leg(
        Position(0, 0, 20), Position(length_m, 0, 20), cruise_m_s=cruise_m_s, acceleration_m_s2=1.0
    ):
        elapsed_s, steps = share * phase.duration_s, 200
        middles_s = [(step + 0.5) * elapsed_s / steps for step in range(steps)]
        summed_j = sum(PAPER.power_w(phase.velocity(middle_s)) for middle_s in middles_s) * elapsed_s / steps
        assert PAPER.energy_j(phase, elapsed_s) == pytest.approx(summed_j, rel=4e-3)


def metered(
    fly: Callable[[ModelAutopilot, EnergyMeter], Coroutine[Any, Any, None]],
    *,
    manner: FlightModel = PLAIN,
    **config: float,
) -> EnergyUsed:
    async def run() -> EnergyUsed:
        meter = EnergyMeter(EnergyConfig(**config), load_w=4.0, radios=1)
        autopilot = ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=4.0, manner=manner, energy=meter)
        await autopilot.claim(resumes=False)
        await fly(autopilot, meter)
        return meter.used()

    return run_virtually(run())


async def up_and_away(autopilot: ModelAutopilot, _: EnergyMeter) -> None:
    await autopilot.arm()
    await autopilot.takeoff(20.0)
    await autopilot.goto(Position(100.0, 0.0, 20.0))
    await asyncio.sleep(60.0)
    await autopilot.goto(Position(0.0, 0.0, 20.0))
    await autopilot.return_home_and_land()
    await autopilot.disarm()


def test_on_the_ground_the_rotors_draw_nothing() -> None:
    used = metered(lambda *_: asyncio.sleep(3600.0))
    assert (used.flight_wh, used.hover_wh) == (0.0, 0.0)
    assert (used.computing_wh, used.radio_wh) == (2.7, 0.8)


def test_a_drone_that_waits_in_the_air_hovers() -> None:
    used = metered(up_and_away)
    assert used.hover_wh == pytest.approx(168.5 * 60.0 / 3600, rel=1e-5)
    assert 150.0 * 84.0 / 3600 < used.flight_wh < 200.0 * 84.0 / 3600  # 10 + 2 * 29 + 16 s


@pytest.mark.parametrize("manner", [PLAIN, arducopter])
def test_how_often_the_battery_is_looked_at_changes_nothing(manner: FlightModel) -> None:
    looks: list[float] = []

    async def looking(autopilot: ModelAutopilot, meter: EnergyMeter) -> None:
        async def look() -> None:
            while True:
                assert autopilot.battery_percent is not None
                looks.append(autopilot.battery_percent)
                await asyncio.sleep(0.3)

        watch = asyncio.create_task(look())
        await up_and_away(autopilot, meter)
        watch.cancel()

    assert metered(looking, manner=manner, battery_wh=50.0) == metered(
        up_and_away, manner=manner, battery_wh=50.0
    )
    assert looks[0] == 100.0
    assert all(later < before for before, later in itertools.pairwise(looks))


@given(st.lists(st.floats(0.0, 30.0), max_size=5), st.lists(st.floats(0.0, 5.0), max_size=5))
def test_calls_and_transfers_add_to_the_computer_and_the_radio(
    loads_j: Sequence[float], transfers_s: Sequence[float]
) -> None:
    async def work(_: ModelAutopilot, meter: EnergyMeter) -> None:
        for load_j in loads_j:
            meter.compute(load_j)
        for transfer_s in transfers_s:
            meter.transfer(transfer_s)
        await asyncio.sleep(10.0)

    used = metered(work)
    assert used.computing_wh == pytest.approx((27.0 + sum(loads_j)) / 3600, abs=1e-6)
    assert used.radio_wh == pytest.approx((8.0 + 0.5 * sum(transfers_s)) / 3600, abs=1e-6)


@played(metered)
async def test_an_endless_battery_is_not_reported(autopilot: ModelAutopilot, meter: EnergyMeter) -> None:
    assert autopilot.battery_percent is None
    assert meter.lasts_s(0.0) == math.inf


async def hover_until_it_is_lost(autopilot: ModelAutopilot) -> None:
    lost = asyncio.Event()
    autopilot.listen(lambda news: lost.set() if isinstance(news, Control) and not news.is_ours else None)
    await autopilot.arm()
    await autopilot.takeoff(20.0)
    await lost.wait()


@pytest.mark.parametrize("hover_w", [50.0, 168.5, 400.0])
@pytest.mark.parametrize("level_percent", [5.0, 60.0])
def test_the_vehicle_lands_by_itself_as_its_battery_comes_to_the_level(
    hover_w: float, level_percent: float
) -> None:
    async def hover(autopilot: ModelAutopilot, meter: EnergyMeter) -> None:
        await hover_until_it_is_lost(autopilot)
        left_percent = autopilot.battery_percent
        assert left_percent is not None
        assert level_percent - 1.0 < left_percent <= level_percent + 1e-9
        await autopilot.stood()
        assert autopilot.position.altitude_m == 0.0

    metered(hover, hover_w=hover_w, battery_wh=20.0, failsafe_percent=level_percent)


def test_an_empty_battery_lets_it_fall() -> None:
    async def hover(autopilot: ModelAutopilot, meter: EnergyMeter) -> None:
        await hover_until_it_is_lost(autopilot)
        assert autopilot.battery_percent == 0.0
        empty_s = asyncio.get_running_loop().time()
        await autopilot.stood()
        assert asyncio.get_running_loop().time() - empty_s < math.sqrt(2 * 20.0 / 9.81) + 0.1

    used = metered(hover, battery_wh=2.0, failsafe_percent=0.0)
    assert 2.0 <= used.total_wh < 2.15


def test_a_phase_at_rest_on_the_ground_is_no_hover() -> None:
    spooling_up = arducopter.takeoff(Position(0.0, 0.0), 20.0)[0]
    assert spooling_up == Phase(Position(0.0, 0.0), Velocity(), 0.0, 0.0, arducopter.spool_up_s)

    async def take_off(autopilot: ModelAutopilot, _: EnergyMeter) -> None:
        await autopilot.arm()
        await autopilot.takeoff(20.0)

    assert metered(take_off, manner=arducopter).hover_wh == 0.0
