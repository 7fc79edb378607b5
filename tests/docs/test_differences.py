"""What docs/differences.md says of upwash beside the thesis holds in small flights under the thesis's policy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from tests.events import written
from tests.scenarios import HEAVY_S, fault, scenario, server

import upwash
from upwash.config.drone import PolicyConfig
from upwash.lab.run import Run, simulate

ROOT = Path(__file__).parents[2]
THESIS = {"name": "location-aware"}
FAST_S = 0.7
SOON = {"join_s": 1.0, "start_s": 1.0}
ALL_THE_WAY = {"range_m": 100.0}


def fly(*servers: dict[str, Any], policy: dict[str, Any] | None = None, **other: Any) -> Run:
    """A line of photos, every 20 m from home, past these servers."""
    run = simulate(scenario(*servers, rows=1, policy={**THESIS, **(policy or {})}, **other))
    assert run.failure == ""
    return run


def at(east_m: float, **truth: Any) -> dict[str, Any]:
    return {"east_m": east_m, "north_m": 0.0, "truth": truth}


def events(run: Run, *names: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] in names]


# --- calls ----------------------------------------------------------------------------------------------------


def test_a_remote_call_ends_at_its_deadline_and_the_drone_computes_it() -> None:
    run = fly(server("s1", **at(50, remote_call_s={"heavy": 60.0}, **SOON)))
    cut, *_ = [call for call in events(run, "call") if call["fell_back"]]
    assert cut["place"] == "local"
    assert cut["delay_s"] == pytest.approx(4 * FAST_S + HEAVY_S)
    (failed, *_) = events(run, "call_failed_in_range")
    assert failed["after"] == "BLACKLISTED"


def test_a_deadline_is_no_longer_than_a_local_call() -> None:
    run = fly(server("s1", **at(50, **SOON), remote_call_s={"light": 0.3, "heavy": 5.0}))
    remote = [event for event in events(run, "decided") if event["decision"] == "remote"]
    assert {each["deadline_s"] for each in remote} == {HEAVY_S}


def test_a_wait_for_a_check_that_seemed_to_end_soon_is_bounded_too() -> None:
    run = fly(server("s1", **at(50, join_s=1.0, start_s=500.0)))
    waits = [event for event in events(run, "decided") if event["decision"] == "wait"]
    assert [wait["check_elapsed_s"] < wait["check_s"] for wait in waits] == [True, False], (
        "waitT > 0, and not"
    )
    failed = [event["waited_s"] for event in events(run, "call") if event.get("wait") == "failed"]
    assert failed == pytest.approx([HEAVY_S * 0.75 - FAST_S] * 2), "X of eq. 3.5"


# --- checks and states ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("truth", "state"), [({"join_s": 30.0}, "AVL"), (SOON | {"start_s": 30.0}, "AVL-R")])
def test_a_check_that_is_left_before_the_start_says_nothing_of_the_services(
    truth: dict[str, float], state: str
) -> None:
    run = fly(server("s1", **at(50, **truth), check_running_s=10.0) | {"range_m": 8.0})
    left, *_ = events(run, "deselected", "deselected_after_start")
    assert (left["before"], left["after"]) == ("CHECK", state)


def test_a_check_that_fails_teaches_nothing() -> None:
    off = fault("s1", "off", to_s=40.0)
    run = fly(server("s1", **at(50)) | ALL_THE_WAY, policy={"blacklist_s": 5.0}, faults=[off])
    assert events(run, "check_failed")
    assert events(run, "started")
    assert {event["check_s"] for event in events(run, "decided") if event["state"] == "CHECK"} == {11.5}


def test_a_check_has_an_end() -> None:
    run = fly(server("s1", **at(50, join_s=500.0)) | ALL_THE_WAY)
    (selected, *_), (failed, *_) = events(run, "selected"), events(run, "check_failed")
    assert failed["t"] - selected["t"] == pytest.approx(3 * 3.5)


def test_a_server_that_lacks_one_of_the_services_is_unavailable_for_the_others_too() -> None:
    services = [
        {"name": "detector", "local_call_s": {"light": 3.0, "heavy": HEAVY_S}},
        {"name": "dirt", "program": f"{ROOT}/scenarios/two_services.py:DirtGauge", "local_call_s": {"": 2.0}},
    ]
    both = {"detector": {"light": 0.3, "heavy": FAST_S}, "dirt": {"": 0.2}}
    truth = {"images": ["detector"], **SOON}
    lacking = server("s1", **at(50, **truth)) | ALL_THE_WAY | {"remote_call_s": both}
    run = fly(lacking, service=services)
    assert run.result.totals.remote == {}
    (failed, *_) = events(run, "check_failed")
    assert "dirt" in failed["why"]
    told = lacking | {"remote_call_s": {"detector": both["detector"]}}
    assert fly(told, service=services).result.totals.remote["s1"] > 0


def test_servers_are_looked_for_at_once_where_a_range_begins_and_a_server_fails() -> None:
    servers = [server("s1", **at(50)), server("s2", **at(60))]
    off = fault("s1", "off", from_s=20.0)
    seldom, often = (fly(*servers, policy={"period_s": each}, faults=[off]) for each in (30.0, 1.0))
    selected = [
        [(event["server"], event["t"]) for event in events(run, "selected")] for run in (seldom, often)
    ]
    assert selected[0] == selected[1]
    assert {name for name, _ in selected[0]} == {"s1", "s2"}


# --- servers that failed or were slow -------------------------------------------------------------------------


def calls_of_a_slow_server(retry_s: float) -> list[float]:
    """When a server was called that is slower than the drone, which does not believe it at first."""
    slow = server("s1", **at(200, **SOON, remote_call_s={"heavy": 12.0})) | {"range_m": 500.0}
    run = fly(slow, policy={"retry_s": retry_s, "blacklist_s": 1.0}, columns=40)
    return [event["t"] for event in events(run, "decided") if event["decision"] == "remote"]


def test_a_slow_server_is_forgiven_after_retry_s_and_never_where_that_is_infinite() -> None:
    never = calls_of_a_slow_server(math.inf)
    forgiven = calls_of_a_slow_server(100.0)
    assert forgiven[: len(never)] == never
    assert forgiven[len(never)] - never[-1] > 100
    assert PolicyConfig().retry_s == 300.0


def test_the_thesiss_policy_leaves_servers_alone_and_hedges_nothing() -> None:
    thesis, default = PolicyConfig(name="location-aware"), PolicyConfig()
    assert (thesis.probing, thesis.hedging, thesis.left_alone_s) == (None, None, 60.0)
    assert default.name == "look-ahead"
    assert default.probing is not None and default.hedging is not None


# --- the experiments ------------------------------------------------------------------------------------------


def light(file: Path, seed: int = 1, /, **overrides: object) -> upwash.Simulation:
    return upwash.simulate(
        file, policy="location-aware", seed=seed, overrides={"mission.mode": "light", **overrides}
    )


def test_disconnects_make_waits_of_the_thesiss_simulation_fail_as_in_figure_4_9() -> None:
    file = ROOT / "src/upwash/lab/reproduction/thesis/simulation.toml"

    def waits(**overrides: object) -> tuple[int, int]:
        flights = [light(file, seed, **overrides).totals for seed in range(1, 11)]
        return sum(flight.waits for flight in flights), sum(flight.waits_failed for flight in flights)

    at_once = {f"server.{name}.truth.leave_s": 0.0 for name in ("s1", "s2")}
    as_it_is, without = waits(), waits(**at_once)
    assert as_it_is > without
    page = " ".join((ROOT / "docs" / "differences.md").read_text().split())
    assert f"there are {as_it_is[0]} waits, {as_it_is[1]} of them wasted;" in page
    assert f"there are {without[0]}, and {without[1]}." in page


def test_slow_light_calls_add_what_the_page_says() -> None:
    file, key = ROOT / "scenarios/thesis.toml", "service.detector.local_joining_slowdown.light"
    plain_s, little_s = (light(file, **{key: each}).totals.service_delay_s for each in (0.0, 0.1))
    page = (ROOT / "docs" / "differences.md").read_text().replace("\n", " ")
    assert f"adds {little_s - plain_s:.1f} s to" in page
