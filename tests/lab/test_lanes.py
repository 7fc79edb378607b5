"""Drones that share a lane: what they learn of it, and that sharing it is no failure."""

from __future__ import annotations

import itertools
from typing import Any

import msgspec
import pytest
from tests.events import written
from tests.scenarios import scenario, server

from upwash.config.drone import DroneConfig
from upwash.lab.run import Run, simulate_fleet

CALL_S, PROCESSING_S = 8.0, 7.0


def world(*, lanes: int, policy: str) -> DroneConfig:
    """Photos so near each other that two drones need a server at the same time, again and again."""
    return scenario(
        server(
            "s1", 0.0, 0.0,
            range_m=500.0,
            remote_call_s={"light": 0.3, "heavy": CALL_S},
            processing_s={"light": 0.2, "heavy": PROCESSING_S},
            truth={"slots": 2, "lanes": lanes},
        ),
        mission={"grid": {"columns": 5, "rows": 3, "spacing_m": 4.0}},
        service=[{"name": "detector", "local_call_s": {"light": 10.0, "heavy": 30.0}}],
        policy={"name": policy},
    )  # fmt: skip


def fly(*names: str, lanes: int, policy: str) -> list[Run]:
    config = world(lanes=lanes, policy=policy)
    return simulate_fleet([msgspec.structs.replace(config, name=name) for name in names])


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def delays_s(run: Run) -> list[float]:
    """Of all calls but the first, which waited for the server's start."""
    return [call["delay_s"] for call in events(run, "call")][1:]


POLICIES = ["location-aware", "look-ahead"]


@pytest.mark.parametrize("policy", POLICIES)
def test_estimates_grow_by_what_calls_wait_for_the_other_drones(policy: str) -> None:
    for run in fly("d1", "d2", lanes=1, policy=policy):
        waited_s = [delay_s - CALL_S for delay_s in delays_s(run)]
        assert max(waited_s) <= PROCESSING_S
        assert min(waited_s[-3:]) > 0.0
        believed_s = events(run, "decided")[-1]["remote_s"]
        assert believed_s == pytest.approx(CALL_S + sum(waited_s[-4:-1]) / 3)


@pytest.mark.parametrize("policy", POLICIES)
def test_no_call_is_cut_short_as_two_drones_share_a_lane(policy: str) -> None:
    for run in fly("d1", "d2", lanes=1, policy=policy):
        assert {call["place"] for call in events(run, "call")} == {"s1"}
        assert not events(run, "remote_failed")


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(("names", "lanes"), [(("d1",), 1), (("d1", "d2"), 2)])
def test_nobody_waits_where_there_is_a_lane_for_each(names: tuple[str, ...], lanes: int, policy: str) -> None:
    for run in fly(*names, lanes=lanes, policy=policy):
        assert delays_s(run) == pytest.approx([CALL_S] * 14)


def test_only_what_is_computed_keeps_the_other_drone_waiting() -> None:
    """Two that call in turns each wait for the other's processing, but not for its way."""
    d1, d2 = fly("d1", "d2", lanes=1, policy="location-aware")
    ended_s = sorted(call["t"] for run in (d1, d2) for call in events(run, "call"))
    gaps_s = [later - before for before, later in itertools.pairwise(ended_s)]
    assert min(gaps_s) == pytest.approx(PROCESSING_S)
