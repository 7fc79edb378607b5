"""Calls that a server is late with, and that the drone's own service starts on too."""

from __future__ import annotations

from typing import Any

import pytest
from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.lab.run import Run, simulate

LATE_AFTER_S = 2 * 0.7 + 0.001  # no delay is known yet


def fly(*faults: dict[str, Any], hedged: bool = True, range_m: float = 500.0, **tables: Any) -> Run:
    hedge = {"hedge": {"after": "p95", "budget": 0.1}} if hedged else {}
    s1 = server("s1", 0.0, 0.0, range_m=range_m)
    return simulate(scenario(s1, faults=faults, **{"policy": {"name": "location-aware", **hedge}, **tables}))


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def hedged_calls(run: Run) -> list[dict[str, Any]]:
    return [call for call in events(run, "call") if "hedged_s" in call]


def test_a_server_that_is_in_time_is_not_hedged() -> None:
    run = fly()
    assert events(run, "hedged") == []
    assert run.log() == fly(hedged=False).log()


def test_a_late_server_may_answer_while_the_drone_computes() -> None:
    slow = fault("s1", "slow", from_s=100.0, to_s=110.0, extra_s=5.0)
    run = fly(slow)
    call = hedged_calls(run)[0]
    assert call["place"] == "s1"
    assert call["hedged_s"] == pytest.approx(LATE_AFTER_S)
    assert call["delay_s"] == pytest.approx(5.7)
    assert not events(run, "remote_failed")
    assert [event["place"] for event in events(run, "dropped")] == ["local"] * len(hedged_calls(run))
    assert run.result.totals.local == 0
    without = fly(slow, hedged=False)
    assert max(event["delay_s"] for event in events(without, "call")[3:]) > 12.0


def test_a_silent_server_costs_little_more_than_a_local_call_and_is_left() -> None:
    run = fly(fault("s1", "stuck", from_s=100.0))
    (call,) = hedged_calls(run)
    assert call["place"] == "local"
    assert call["delay_s"] == pytest.approx(LATE_AFTER_S + 10.0)
    assert len(events(run, "call_failed_in_range")) == 1
    assert run.result.totals.calls == 18


def test_the_next_local_call_waits_for_the_service_to_be_done_with_a_dropped_one() -> None:
    slow = fault("s1", "slow", extra_s=3.0)
    run = fly(slow, range_m=42.0, vehicle={"acceleration_m_s2": 50.0}, mission={"ground_speed_m_s": 50.0})
    calls = events(run, "call")
    queued = [number for number, call in enumerate(calls) if "queued_s" in call]
    assert queued
    for number in queued:
        assert calls[number - 1]["place"] == "s1"
        assert calls[number]["delay_s"] == pytest.approx(calls[number]["queued_s"] + 10.0)
        assert calls[number]["onboard_s"] == pytest.approx(10.0)  # what is learnt is without the wait


def test_no_call_is_hedged_while_the_drone_computes_one_that_a_server_has_answered() -> None:
    run = fly(
        fault("s1", "slow", from_s=50.0, extra_s=3.0),
        policy={"name": "location-aware", "hedge": {"after": "p50", "budget": 1.0}},
        vehicle={"acceleration_m_s2": 50.0},
        mission={"ground_speed_m_s": 50.0},
    )
    names = [event["event"] for event in written(run.events) if event["event"] in ("hedged", "dropped")]
    assert names == ["hedged", "dropped"] * 3
    assert len([call for call in events(run, "call") if call["delay_s"] > 3.0]) > 4
