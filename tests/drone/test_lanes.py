"""Which lanes the drone's own calls hold: a server with one of them gets no other, on virtual time."""

from __future__ import annotations

import random
from typing import Any

import pytest
from tests.scenarios import scenario, server

from upwash.config import DroneConfig
from upwash.eventlog import schema
from upwash.lab.run import simulate

MANNERS: dict[str, dict[str, Any]] = {
    "default": {},
    "probes": {"policy": {"hedge": False}},
    "hedges": {"policy": {"hedge": {"after": "p50", "budget": 1.0}, "blacklist_s": 60.0}},
    "location-aware": {"policy": {"name": "location-aware", "probe": {}}},
    "two radios": {"network": {"radios": 2}},
    "two answers": {"two_answers": {"first": "light", "within_s": 30.0}},
}


def drawn(seed: int, *, two_answers: Any = None, **tables: Any) -> DroneConfig:
    """Photos in flight past one or two servers of a lane each; nothing fails, and all takes as long as believed."""
    chance = random.Random(seed)
    spacing_m, local_s = chance.uniform(8.0, 25.0), chance.uniform(4.0, 12.0)
    service: dict[str, Any] = {"name": "detector", "local_call_s": {"light": 1.0, "heavy": local_s}}
    service |= {} if two_answers is None else {"two_answers": two_answers}
    servers = [
        server(
            f"s{number}",
            chance.uniform(0.0, 6 * spacing_m),
            chance.uniform(0.0, 3 * spacing_m),
            range_m=chance.uniform(4.0, 20.0) * spacing_m,
            remote_call_s={"light": 0.5, "heavy": chance.uniform(0.3, 1.0) * local_s},
        )
        for number in range(chance.choice([1, 2]))
    ]
    grid = {"columns": 7, "rows": 4, "spacing_m": spacing_m}
    mission = {"photos": {"every_m": spacing_m}, "ground_speed_m_s": 6.0, "grid": grid}
    return scenario(*servers, **{"service": [service], "mission": mission, **tables})


@pytest.mark.parametrize("manner", MANNERS)
@pytest.mark.parametrize("seed", range(12))
def test_no_call_fails_at_a_server_that_computes_another_of_the_drone(manner: str, seed: int) -> None:
    run = simulate(drawn(seed, **MANNERS[manner]))
    assert run.failure == "" and run.result.completed
    failed = [event.why for event in run.events if isinstance(event, schema.RemoteFailed)]
    assert [why for why in failed if "closed" not in why] == [], "a policy may leave a server in a call"
