"""The scenarios of the corpus that have one drone: what each promises to show."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import msgspec
import pytest

from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.lab.scenario import read_scenario

pytestmark = pytest.mark.xdist_group("scenarios")  # each flight is flown once, and not by every process

ROOT = Path(__file__).parents[2]
ENDED_BY_BATTERY = {"thesis-battery"}  # flown in tests/lab/test_energy.py: not every policy completes it
FILES = {
    file.stem: file
    for file in sorted((ROOT / "scenarios").glob("*.toml"))
    if file.stem not in ENDED_BY_BATTERY and not file.stem.startswith("fleet-")
}
POLICIES = ("local-only", "opportunistic", "location-aware", "look-ahead")
DOCUMENTED = re.findall(
    r"^\| `([\w-]+)` \| [^|]+ \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$",
    (ROOT / "docs/scenarios.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)


# A server's better answer demands what the drone's misses: with servers more is done.
SERVERS_SEE_MORE = {"two-answers"}


@functools.cache
def fly(scenario: str, policy: str = "location-aware") -> Run:
    return simulate(read_scenario(FILES[scenario], policy=policy))


def time_s(scenario: str, policy: str = "location-aware") -> float:
    return fly(scenario, policy).result.mission_time_s


def gain(scenario: str) -> float:
    """The share of the mission's time that offloading saves."""
    return 1 - time_s(scenario) / time_s(scenario, "local-only")


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("scenario", FILES)
def test_every_mission_is_completed_and_no_later_than_without_servers(scenario: str, policy: str) -> None:
    run = fly(scenario, policy)
    assert run.failure == "" and run.result.completed
    if scenario not in SERVERS_SEE_MORE:
        assert run.result.mission_time_s <= time_s(scenario, "local-only") + 1.0


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("scenario", FILES)
def test_no_mission_beats_the_bounds(scenario: str, policy: str) -> None:
    bound = bound_of(fly(scenario, policy), read_scenario(FILES[scenario]))
    assert bound is not None
    assert bound.free_s <= bound.with_joins_s <= time_s(scenario, policy) + 1e-6


@pytest.mark.parametrize("scenario", [name for name in FILES if name not in SERVERS_SEE_MORE])
def test_the_bounds_are_those_of_the_world_whatever_policy_flew_in_it(scenario: str) -> None:
    config = read_scenario(FILES[scenario])
    bounds = [bound_of(fly(scenario, policy), config) for policy in POLICIES]
    for other in bounds[1:]:
        assert bounds[0] is not None and other is not None
        assert other.free_s == pytest.approx(bounds[0].free_s)
        assert other.with_joins_s == pytest.approx(bounds[0].with_joins_s)


@pytest.mark.parametrize("scenario", FILES)
def test_every_file_begins_with_what_it_shows(scenario: str) -> None:
    first, second, *_ = FILES[scenario].read_text(encoding="utf-8").splitlines()
    assert first.startswith("# ") and (second.startswith("#") or second == "seed = 1")


def test_the_page_has_every_scenario_with_its_times() -> None:
    assert sorted(name for name, *_ in DOCUMENTED) == sorted(FILES)
    for name, *minutes in DOCUMENTED:
        for policy, written in zip(POLICIES, minutes, strict=True):
            assert time_s(name, policy) / 60 == pytest.approx(float(written), abs=0.06), f"{name}, {policy}"


def test_on_a_power_line_every_cell_is_used_after_its_start() -> None:
    remote = fly("power-line").result.totals.remote
    assert len(remote) == 15
    assert max(remote.values()) <= 4
    assert 0.15 < gain("power-line") < 0.35


def above_bound(scenario: str, policy: str) -> float:
    """The share by which the mission is longer than the theoretical minimum."""
    bound = bound_of(fly(scenario, policy), read_scenario(FILES[scenario]))
    assert bound is not None
    return time_s(scenario, policy) / bound.free_s - 1


def test_along_a_line_of_small_cells_looking_ahead_wins_back_most_of_what_reacting_loses() -> None:
    assert above_bound("power-line-heavy", "location-aware") > 0.1
    assert above_bound("power-line-heavy", "look-ahead") < 0.05
    assert above_bound("power-line-light", "location-aware") > 0.1
    assert above_bound("power-line-light", "look-ahead") < 0.07


@pytest.mark.parametrize("scenario", FILES)
def test_looking_ahead_costs_nothing_anywhere(scenario: str) -> None:
    assert time_s(scenario, "look-ahead") <= time_s(scenario) + 0.1


def test_in_a_dense_city_the_fast_servers_do_the_work() -> None:
    remote = fly("dense-city").result.totals.remote
    fast = sum(remote[name] for name in ("school", "garage", "bank", "theatre"))
    assert fast > 0.9 * sum(remote.values())
    assert time_s("dense-city") < 0.9 * time_s("dense-city", "opportunistic")


def test_in_fast_flight_few_calls_are_worth_sending_and_few_waits_worth_it() -> None:
    totals = fly("fast-flight").result.totals
    assert totals.local > 2 * sum(totals.remote.values()) > 0
    assert totals.waits <= 2
    assert 0.0 < gain("fast-flight") < 0.1


def test_a_loaded_server_is_found_out_and_avoided() -> None:
    aware, naive = (
        fly("loaded-server", policy).result.totals for policy in ("location-aware", "opportunistic")
    )
    assert aware.remote["s2"] < 0.6 * naive.remote["s2"]
    assert 1.06 < time_s("loaded-server", "opportunistic") / time_s("loaded-server") < 1.13


def slow_at_first(scenario: str, *, patient_first_call: bool) -> Run:
    """The scenario with servers on which a service's first call takes 2 s longer."""
    replace, config = msgspec.structs.replace, read_scenario(FILES[scenario], policy="look-ahead")
    servers = tuple(
        replace(server, truth=replace(server.truth, first_extra_s=2.0)) for server in config.servers
    )
    policy = replace(config.policy, patient_first_call=patient_first_call, blacklist_s=60.0, hedge=False)
    return simulate(replace(config, servers=servers, policy=policy))


def test_a_slow_first_call_is_cut_short_at_each_server_or_awaited_with_patience() -> None:
    hurried, patient = (
        slow_at_first("power-line-light", patient_first_call=patience) for patience in (False, True)
    )
    assert (hurried.result.totals.fallbacks, patient.result.totals.fallbacks) == (15, 0)
    assert patient.result.mission_time_s < 0.9 * hurried.result.mission_time_s


def test_the_first_call_after_each_start_takes_its_extra() -> None:
    calls = slow_at_first("power-line-heavy", patient_first_call=True).result.calls
    remote_s = [call.delay_s - call.waited_s for call in calls if call.place != "local"]
    slow = [delay_s for delay_s in remote_s if delay_s == pytest.approx(2.7)]
    assert len(slow) == 20  # one for each pole
    assert all(delay_s == pytest.approx(0.7) for delay_s in remote_s if delay_s not in slow)


def test_flapping_servers_cost_fallbacks_and_not_the_mission() -> None:
    totals = fly("flapping-servers").result.totals
    assert totals.fallbacks > 0
    assert totals.calls == 81
    assert "s3" not in totals.remote  # it lies


def test_nobody_waits_for_a_cold_server() -> None:
    totals = fly("cold-far-server").result.totals
    assert totals.waits == 0
    assert totals.remote["barn"] > 20


def test_two_services_are_served_by_the_server_that_has_both() -> None:
    totals = fly("two-services").result.totals
    assert totals.remote["inverter-hall"] > 5 * totals.remote["gatehouse"]
    operations = {call.operation for call in fly("two-services").result.calls if call.place == "gatehouse"}
    assert operations == {"detector.process_photo[heavy]"}


def test_without_servers_all_policies_are_the_same() -> None:
    assert len({time_s("no-servers", policy) for policy in POLICIES}) == 1
    assert fly("no-servers").result.totals.local == 64
