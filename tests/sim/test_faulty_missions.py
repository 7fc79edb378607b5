"""Missions among faulty servers: they go on, and the promises hold."""

from __future__ import annotations

import functools
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.config.drone import DroneConfig
from upwash.config.world import Lie
from upwash.lab.faults.promises import History, broken_promises
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate, simulate_fleet

SERVER_KINDS = ("off", "stuck", "slow", "garbage", "wrong", "flapping", "full", "crash")
LINK_KINDS = ("off", "stuck", "slow", "flapping")
SERVERS = (server("s1", 20.0, 20.0), server("s2", 80.0, 20.0))


@functools.lru_cache
def alone(columns: int, rows: int) -> Run:
    run = simulate(scenario(columns=columns, rows=rows))
    assert run.result.completed
    return run


def fly(config: DroneConfig, by_itself: Run | None) -> Run:
    """Flies the mission and tests the promises."""
    seen: list[Observation] = []
    (run,) = simulate_fleet([config], seen=seen)
    assert broken_promises(History(config, run, seen, by_itself), seed=config.seed) == []
    return run


def test_without_faults_the_servers_are_used() -> None:
    config = scenario(*SERVERS)
    run = fly(config, alone(6, 3))
    assert run.result.totals.local <= 4 and run.result.totals.fallbacks == 0
    assert run.result.mission_time_s < 0.6 * alone(6, 3).result.mission_time_s


@pytest.mark.parametrize(("from_s", "to_s"), [(0.0, 1e6), (0.0, 60.0), (25.0, 90.0), (63.0, 71.0)])
@pytest.mark.parametrize(
    ("prefix", "kind"),
    [*[("", kind) for kind in SERVER_KINDS], *[("link:", kind) for kind in LINK_KINDS]],
)
def test_a_mission_goes_on_among_faulty_servers(prefix: str, kind: str, from_s: float, to_s: float) -> None:
    faults = [fault(f"{prefix}{name}", kind, from_s=from_s, to_s=to_s) for name in ("s1", "s2")]
    fly(scenario(*SERVERS, faults=faults), alone(6, 3))


@pytest.mark.parametrize("from_s", [0.0, 0.001, 0.002, 0.003, 0.004, 0.005, 30.0, 60.0])
@pytest.mark.parametrize("lie", get_args(Lie))
def test_a_mission_goes_on_among_liars(lie: str, from_s: float) -> None:
    """Each way to tell the lie comes first in one of these."""
    faults = [fault(name, "lying", lie=lie, from_s=from_s) for name in ("s1", "s2")]
    run = fly(scenario(*SERVERS, faults=faults, policy={"blacklist_s": 5.0}), alone(6, 3))
    assert run.result.totals.calls == 18


@pytest.mark.parametrize("from_s", [0.0, 5.0, 20.0, 43.0, 1e6])
@pytest.mark.parametrize("kind", LINK_KINDS)
def test_a_mission_with_a_faulty_autopilot_ends_and_says_why(kind: str, from_s: float) -> None:
    config = scenario(*SERVERS, faults=[fault("autopilot", kind, from_s=from_s)])
    run = fly(config, None)
    assert run.result.completed is (run.failure == "")
    assert run.result.completed is (kind == "slow" or from_s == 1e6)
    ended = "mission_completed" if run.result.completed else "mission_ended"
    assert ended in [event["event"] for event in written(run.events)]


windows = st.tuples(st.floats(0.0, 200.0), st.floats(0.0, 200.0)).map(sorted)
kinds_by_prefix = st.one_of(
    st.tuples(st.just(""), st.sampled_from(SERVER_KINDS)),
    st.tuples(st.just("link:"), st.sampled_from(LINK_KINDS)),
)


@st.composite
def scenarios(draw: st.DrawFn) -> DroneConfig:
    names = [f"s{number}" for number in range(1, draw(st.integers(1, 3)) + 1)]
    places = st.floats(-20.0, 120.0)
    servers = [
        server(
            name,
            draw(places),
            draw(places),
            range_m=draw(st.floats(15.0, 120.0)),
            truth={
                "join_s": draw(st.floats(0.0, 12.0)),
                "start_s": draw(st.floats(0.0, 20.0)),
                "remote_call_s": {"light": 0.3, "heavy": draw(st.floats(0.0, 15.0))},
            },
        )
        for name in names
    ]
    faults: list[dict[str, Any]] = []
    for _ in range(draw(st.integers(0, 4))):
        (prefix, kind), (from_s, to_s) = draw(kinds_by_prefix), draw(windows)
        extra_s = draw(st.floats(0.0, 20.0))
        target = prefix + draw(st.sampled_from(names))
        faults.append(fault(target, kind, from_s=from_s, to_s=to_s, extra_s=extra_s))
    policy = {
        "name": draw(st.sampled_from(["location-aware", "opportunistic", "look-ahead"])),
        "gain_switch": draw(st.sampled_from([0.0, 0.25, 0.5])),
        "gain_wait": draw(st.sampled_from([0.0, 0.25, 0.5])),
        "blacklist_s": draw(st.sampled_from([5.0, 60.0])),
    }
    vehicle = {"profile": "arducopter"} if draw(st.booleans()) else {}
    return scenario(*servers, faults=faults, columns=3, rows=2, policy=policy, vehicle=vehicle)


@given(scenarios())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_the_promises_hold_in_any_scenario(config: DroneConfig) -> None:
    run = fly(config, simulate(msgspec.structs.replace(config, servers=(), faults=())))
    assert simulate(config).log() == run.log()
