"""Which network each of a flight's radios is given."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import pytest

from upwash.config.drone_file import drone_config
from upwash.core.geo import Position
from upwash.drone.networks import NoNetwork, PositionNetwork
from upwash.errors import NetworkError
from upwash.launch.drone import opened_networks
from upwash.ports import Network
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.journal import MemoryJournal
from upwash.sim.vehicle import Plain

FLIGHT: dict[str, Any] = {
    "mission": {"waypoints_m": [[0, 0]]},
    "server": [{"name": "s1", "east_m": 1000.0, "north_m": 0.0, "range_m": 50.0, "truth": {"join_s": 0.0}}],
}


def networks(**tables: Any) -> list[Network]:
    config = drone_config({**FLIGHT, **tables}, Path("drone.toml"))

    async def opened() -> list[Network]:
        plain = Plain(acceleration_m_s2=1.0, takeoff_s=1.0, return_and_land_s=1.0)
        autopilot = ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=4.0, manner=plain)
        async with contextlib.AsyncExitStack() as stack:
            try:
                return await opened_networks(config, autopilot, MemoryJournal(), stack)
            finally:
                await autopilot.close()

    return asyncio.run(opened())


@pytest.mark.parametrize("tables", [{}, {"network": {"radios": 2}}, {"network": {"kind": "wired"}}])
def test_a_flight_joins_nothing_unless_asked_to(tables: dict[str, Any]) -> None:
    found = networks(**tables)
    assert len(found) == tables.get("network", {}).get("radios", 1)
    assert all(isinstance(each, NoNetwork) for each in found)
    asyncio.run(found[0].join("s1", timeout_s=0.0))


def test_the_modelled_radio_is_asked_for_by_name_and_goes_by_the_drones_position() -> None:
    (found,) = networks(network={"kind": "stand-in"})
    assert isinstance(found, PositionNetwork)
    with pytest.raises(NetworkError, match="out of range"):
        asyncio.run(found.join("s1", timeout_s=1.0))


@pytest.mark.parametrize("leave_s", [0.0, 0.2])
def test_the_modelled_radio_leaves_in_the_time_that_the_file_says(leave_s: float) -> None:
    truth = {"join_s": 0.0, "leave_s": leave_s}
    here = {**FLIGHT["server"][0], "east_m": 0.0, "truth": truth}
    (found,) = networks(server=[here], network={"kind": "stand-in"})

    async def joined_again_after_s() -> float:
        await found.join("s1", timeout_s=1.0)
        began_s = asyncio.get_running_loop().time()
        await found.leave()
        await found.join("s1", timeout_s=1.0)
        return asyncio.get_running_loop().time() - began_s

    assert leave_s <= asyncio.run(joined_again_after_s()) + 0.01 < leave_s + 0.15
