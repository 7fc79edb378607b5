"""A server that fails for a while, as the mission sees it: what its failure costs, and how soon it is back."""

from __future__ import annotations

from typing import Any

import pytest
from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.config.drone import DroneConfig
from upwash.errors import ConfigError
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate, simulate_fleet
from upwash.rpc.protocol import LEAVE

FROM_S, TO_S = 100.0, 130.0
HEDGED_AFTER_S, LOCAL_S, REMOTE_S = 1.4, 10.0, 0.7  # twice the estimate, as few delays are known


def world(*faults: dict[str, Any], **policy: Any) -> DroneConfig:
    return scenario(server("s1", 0.0, 0.0, range_m=500.0), faults=faults, policy=policy, columns=8, rows=4)


def fly(target: str, kind: str, *, to_s: float = TO_S, **policy: Any) -> Run:
    return simulate(world(fault(target, kind, from_s=FROM_S, to_s=to_s), **policy))


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


FAULTS = [("link:s1", "stuck"), ("link:s1", "off"), ("s1", "stuck"), ("s1", "off"), ("s1", "garbage")]


@pytest.mark.parametrize(("target", "kind"), FAULTS)
def test_a_server_is_back_soon_after_its_fault_also_for_a_call_that_has_begun(target: str, kind: str) -> None:
    run = fly(target, kind)
    calls = events(run, "call")
    first = next(call for call in calls if call["t"] > TO_S and call["place"] == "s1")
    join_s = 3.5 if kind == "off" and target != "s1" else 0.0
    wanted_s = next(call["t"] - call["delay_s"] for call in calls if call["t"] > TO_S)
    assert first["t"] - max(TO_S, wanted_s) < 1.1 + REMOTE_S + join_s


@pytest.mark.parametrize(("target", "kind"), FAULTS)
def test_a_fault_costs_one_call_its_hedge_and_no_other_call_anything(target: str, kind: str) -> None:
    run = fly(target, kind)
    delays_s = sorted(call["delay_s"] for call in events(run, "call"))
    assert delays_s[-1] <= HEDGED_AFTER_S + LOCAL_S + 0.01
    assert delays_s[-2] <= LOCAL_S + 0.01
    assert run.result.totals.waits_failed == 0


def test_a_call_that_the_drone_answers_before_a_server_that_is_back_did_not_fall_back() -> None:
    faults = (fault("s1", "stuck", from_s=FROM_S, to_s=TO_S), fault("s1", "stuck", from_s=TO_S + 1.0))
    calls = [call for call in events(simulate(world(*faults)), "call") if call["t"] > FROM_S]
    first, second = calls[:2]
    assert (first["place"], first["fell_back"]) == ("local", True)
    assert (second["place"], second["fell_back"]) == ("local", False), "the server was merely late"
    assert first["decision"] == "server ready; no usable answer, so on the drone"
    assert "on the drone" not in second["decision"]


def test_a_server_that_is_dead_for_good_is_asked_about_once_a_second() -> None:
    run = fly("s1", "off", to_s=10_000.0)
    assert events(run, "call")[-1]["place"] == "local"
    assert len(events(run, "call_failed_in_range")) == 1
    assert events(run, "check_failed") == []


def test_a_server_that_is_slower_than_the_drone_is_tried_with_one_call_at_a_time_and_costs_none() -> None:
    run = simulate(world(fault("s1", "slow", from_s=FROM_S, to_s=TO_S, extra_s=12.0)))
    calls = events(run, "call")
    assert max(call["delay_s"] for call in calls) <= HEDGED_AFTER_S + LOCAL_S + 0.01
    after = [call for call in calls if call["t"] - call["delay_s"] > TO_S + 12.0 + LOCAL_S]
    assert {call["place"] for call in after} == {"s1"}
    assert max(call["delay_s"] for call in after) < 1.0


def test_a_call_on_the_drone_is_sent_to_a_server_that_becomes_ready_meanwhile() -> None:
    config = scenario(
        server(
            "s1",
            0.0,
            0.0,
            range_m=500.0,
            check_s=25.0,
            check_running_s=15.0,
            truth={"join_s": 15.0, "start_s": 1.0},
        )
    )
    run = simulate(config)
    first = events(run, "call")[0]
    assert first["place"] == "s1" and "became of use" in first["decision"]
    assert events(run, "started")[0]["t"] + REMOTE_S == pytest.approx(first["t"])
    alone = simulate(scenario(*(), faults=()))
    assert run.result.totals.calls == alone.result.totals.calls


def test_the_rule_of_the_thesis_is_there_for_who_asks_for_it() -> None:
    run = fly("s1", "off", blacklist_s=60.0)
    back = next(call for call in events(run, "call") if call["t"] > TO_S and call["place"] == "s1")
    assert back["t"] - TO_S > 30.0
    assert not any(event["event"].startswith("probed") for event in written(run.events))


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ({"blacklist_s": 60.0, "probe": {}}, "give one of them"),
        ({"probe": {"first_s": 0.0}}, "from 0.2 to 60"),
        ({"probe": {"first_s": 0.1}}, "from 0.2 to 60"),
        ({"probe": {"first_s": 5.0}}, "pauses grow"),
        ({"hedge": 3}, "hedge"),
    ],
)
def test_settings_that_cannot_be_are_told(policy: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        world(**policy)


def test_a_server_that_is_well_again_and_not_wanted_is_told_so() -> None:
    config = scenario(
        server("s1", 0.0, 0.0, range_m=500.0, remote_call_s={"light": 0.4, "heavy": 0.8}),
        server("s2", 0.0, 0.0, range_m=500.0, remote_call_s={"light": 0.4, "heavy": 0.6}),
        faults=[fault("s2", "off", from_s=0.0, to_s=110.0), fault("s1", "off", from_s=FROM_S, to_s=TO_S)],
        network={"radios": 2},
        columns=8,
        rows=4,
    )
    seen: list[Observation] = []
    (run,) = simulate_fleet([config], seen=seen)
    (answered_s,) = (
        event["t"]
        for event in written(run.events)
        if event["event"].startswith("probed") and event["server"] == "s1"
    )
    said_s = [fact.t for fact in seen if fact.path == LEAVE and fact.server == "s1"]
    assert any(answered_s <= t_s < answered_s + 0.5 for t_s in said_s)
