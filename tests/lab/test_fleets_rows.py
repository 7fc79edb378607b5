"""Drones in rows that share a server: a call that waits behind those of other drones is no failure of the server."""

from __future__ import annotations

import random
from statistics import fmean
from typing import Any

import msgspec
import pytest
from tests.scenarios import scenario, server

from upwash.config.drone import DroneConfig
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate_drones

ROWS_M = [
    (0.0, 60.0),
    (90.0, 60.0),
    (90.0, 45.0),
    (0.0, 45.0),
    (0.0, 30.0),
    (90.0, 30.0),
    (90.0, 15.0),
    (0.0, 15.0),
]
BOTH_LANES_S, RIGHT_S = (
    184.0,
    200.0,
)  # at work all the time, and what a known queue makes possible with some room


def fleet(
    drones: int,
    *,
    every_m: float,
    local_s: float,
    call_s: float,
    truth: dict[str, Any],
    order: str = "oldest",
    **tables: Any,
) -> DroneConfig:
    """Drones above fields side by side, in range of one server all the time."""
    ends_m = [*ROWS_M, (0.0, 0.0), (90.0, 0.0)]
    near = server(
        "s1",
        150.0,
        40.0,
        range_m=5000.0,
        check_s=8.0,
        check_running_s=3.0,
        remote_call_s={"light": call_s / 2, "heavy": call_s},
        truth=truth,
    )
    return scenario(
        near,
        mission={
            "waypoints_m": ends_m,
            "photos": {"every_m": every_m, "order": order},
            "ground_speed_m_s": 5.0,
        },
        camera={"photo_s": 0.0},
        vehicle={"acceleration_m_s2": 1.5, "takeoff_s": 10.0, "return_and_land_s": 16.0},
        service=[{"name": "detector", "local_call_s": {"light": local_s / 2, "heavy": local_s}}],
        drone=[
            {
                "name": f"d{number}",
                "departs_s": 2.0 * number,
                "waypoints_m": [(east_m + 105.0 * number, north_m) for east_m, north_m in ends_m],
            }
            for number in range(drones)
        ],
        **{"policy": {"name": "look-ahead"}, **tables},
    )


def failed(run: Run) -> list[str]:
    return [event.why for event in run.events if isinstance(event, schema.CallFailedInRange)]


def mean_s(config: DroneConfig) -> float:
    """The mean time of the missions, which all end, and in which no server is blamed."""
    runs = simulate_drones(config).values()
    assert [failed(run) for run in runs] == [[]] * len(runs)
    assert all(run.result.completed for run in runs)
    return fmean(run.result.mission_time_s or 0.0 for run in runs)


def test_three_drones_are_as_quick_as_a_known_queue_allows() -> None:
    config = fleet(3, every_m=15.0, local_s=9.0, call_s=3.0, truth={"slots": 8, "lanes": 1})
    assert BOTH_LANES_S <= mean_s(config) <= RIGHT_S


def test_drones_that_wait_at_one_server_use_another() -> None:
    one = fleet(6, every_m=15.0, local_s=9.0, call_s=3.0, truth={"slots": 8, "lanes": 1})
    times = {"detector": {"light": 1.8, "heavy": 3.6}}
    slower = msgspec.structs.replace(one.servers[0], name="s2", remote_call_s=times)
    both = msgspec.structs.replace(one, servers=(*one.servers, slower))
    assert mean_s(both) < 0.92 * mean_s(one)


@pytest.mark.parametrize("order", ["oldest", "newest"])
@pytest.mark.parametrize("seed", range(10))
def test_no_server_is_blamed_for_its_queue(seed: int, order: str) -> None:
    chance = random.Random(seed)
    drones = chance.randint(2, 6)
    config = fleet(
        drones,
        every_m=chance.uniform(12.0, 30.0),
        local_s=chance.uniform(3.0, 14.0),
        call_s=chance.uniform(0.5, 5.0),
        truth={"slots": chance.choice([drones, "auto"]), "lanes": chance.choice([1, 1, 2])},
        order=order,
        noise={"call": chance.choice([0.0, 0.1])},
    )
    for run in simulate_drones(config).values():
        assert run.failure == "" and run.result.completed
        assert failed(run) == []


def test_a_server_that_hangs_is_blamed_by_those_whose_calls_it_began() -> None:
    hung = {"target": "s1", "kind": "hung", "from_s": 60.0, "to_s": 1000.0}
    config = fleet(3, every_m=15.0, local_s=9.0, call_s=3.0, truth={"slots": 8, "lanes": 1}, fault=[hung])
    runs = simulate_drones(config).values()
    assert all(run.failure == "" and run.result.completed for run in runs)
    assert any(failed(run) for run in runs)
