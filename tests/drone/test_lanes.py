"""Which lanes the drone's own calls hold: a server with one of them gets no other, on virtual time."""

from __future__ import annotations

import random
from typing import Any

import pytest
from tests.scenarios import scenario, server

from upwash.config.drone import DroneConfig
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


def backlog(
    local_s: float, remote_s: float | None, *, order: str, spacing_m: float, **tables: Any
) -> DroneConfig:
    """Photos in flight above a server that is there from the first one on, and as fast as believed."""
    servers = [] if remote_s is None else [CLOSE | {"remote_call_s": {"light": 0.1, "heavy": remote_s}}]
    service = {"name": "detector", "local_call_s": {"light": 1.0, "heavy": local_s}}
    grid = {"columns": 6, "rows": 3, "spacing_m": spacing_m}
    photos = {"every_m": spacing_m, "order": order}
    mission = {"photos": photos, "ground_speed_m_s": 6.0, "grid": grid}
    return scenario(*servers, **{"service": [service], "mission": mission, **tables})


CLOSE = server("s1", 0.0, 0.0, range_m=1000.0, check_s=1.0, check_running_s=1.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_faster_server_makes_no_mission_slower_and_none_slower_than_alone(seed: int) -> None:
    """But for one call of the slower server: the lanes end within that of each other, as calls are not divided."""
    chance = random.Random(seed)
    local_s = 10 ** chance.uniform(0.0, 1.4)
    order, spacing_m = chance.choice(["oldest", "newest"]), chance.uniform(6.0, 30.0)

    def took_s(remote_s: float | None) -> float:
        run = simulate(backlog(local_s, remote_s, order=order, spacing_m=spacing_m))
        assert run.result.completed and run.result.mission_time_s is not None
        return run.result.mission_time_s

    alone_s = took_s(None)
    fastest_s, slower_s = alone_s, local_s
    for share in sorted((chance.uniform(0.05, 1.0) for _ in range(4)), reverse=True):
        served_s = took_s(share * local_s)
        assert served_s <= fastest_s + slower_s
        assert served_s <= alone_s + 0.01
        fastest_s, slower_s = min(fastest_s, served_s), share * local_s


@pytest.mark.parametrize("order", ["oldest", "newest"])
def test_a_free_drone_takes_the_first_call_that_it_answers_before_the_server_gets_to_it(order: str) -> None:
    """The drone takes 10 s for a call, the server 4: the drone's are each third one, in line order."""
    run = simulate(backlog(10.0, 4.0, order=order, spacing_m=6.0))
    of_drone = [call for call in run.result.calls if call.server is None]
    of_server = [call for call in run.result.calls if call.server == "s1"]
    assert len(of_drone) == pytest.approx(len(run.result.calls) * 4 / 14, abs=1.5)
    ends_s = [max(call.at_s + call.delay_s for call in calls) for calls in (of_drone, of_server)]
    assert abs(ends_s[0] - ends_s[1]) < 10.0, (
        "the drone idles only before a call that the server answers sooner"
    )
    if order == "oldest":
        for calls in (of_drone, of_server):
            assert [call.waypoint for call in calls] == sorted(call.waypoint or 0 for call in calls)
