"""The scenarios of the corpus that have several drones: what each promises to show."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import pytest

from upwash import FleetSimulation, simulate_fleet

pytestmark = pytest.mark.xdist_group("fleets")  # each fleet is flown once, and not by every process

ROOT = Path(__file__).parents[2]
FILES = {file.stem: file for file in sorted((ROOT / "scenarios").glob("fleet-*.toml"))}
POLICIES = ("local-only", "opportunistic", "location-aware", "look-ahead")
CELL = r"([\d.]+) / ([\d.]+) / ([\d.]+)"
DOCUMENTED = re.findall(
    rf"^\| `(fleet-[\w-]+)` \| [^|]+ \| ([\d.]+) \| {CELL} \| {CELL} \| {CELL} \| {CELL} \|$",
    (ROOT / "docs/scenarios.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)


@functools.cache
def fly(scenario: str, policy: str = "look-ahead") -> FleetSimulation:
    return simulate_fleet(FILES[scenario], policy=policy)


def mean_s(scenario: str, policy: str = "look-ahead") -> float:
    fleet = fly(scenario, policy)
    assert fleet.mean_s is not None
    return fleet.mean_s


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("scenario", FILES)
def test_every_drone_completes_its_mission_and_none_is_worse_off_than_alone(
    scenario: str, policy: str
) -> None:
    fleet = fly(scenario, policy)
    assert fleet.failures == {}
    assert fleet.saved_s.keys() == {name for name, each in fleet.drones.items() if not each.vanished}
    assert min(fleet.saved_s.values()) > -1.0


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("scenario", FILES)
def test_no_fleet_beats_its_bounds(scenario: str, policy: str) -> None:
    bound = fly(scenario, policy).bound
    assert bound is not None
    assert bound.free_s <= bound.shared_s + 1e-6
    assert max(bound.with_joins_s, bound.shared_s) <= mean_s(scenario, policy) + 1e-6


@pytest.mark.parametrize("scenario", FILES)
def test_every_file_begins_with_what_it_shows(scenario: str) -> None:
    first, *_ = FILES[scenario].read_text(encoding="utf-8").splitlines()
    assert first.startswith("# ")


def test_the_page_has_every_fleet_with_its_times() -> None:
    assert sorted(name for name, *_ in DOCUMENTED) == sorted(FILES)
    for name, bound_min, *cells in DOCUMENTED:
        bound = fly(name).bound
        assert bound is not None and bound.shared_s / 60 == pytest.approx(float(bound_min), abs=0.06)
        for number, policy in enumerate(POLICIES):
            mean, worst, jain = map(float, cells[3 * number : 3 * number + 3])
            fleet = fly(name, policy)
            assert fleet.mean_s is not None and fleet.worst_s is not None
            assert fleet.mean_s / 60 == pytest.approx(mean, abs=0.15), f"{name}, {policy}"
            assert fleet.worst_s / 60 == pytest.approx(worst, abs=0.15), f"{name}, {policy}"
            assert fleet.jain == pytest.approx(jain, abs=0.05), f"{name}, {policy}"


@pytest.mark.parametrize("scenario", ["fleet-same-field", "fleet-adjacent-fields", "fleet-crossing-routes"])
def test_drones_that_are_alike_gain_alike(scenario: str) -> None:
    assert (fly(scenario).jain or 0.0) > 0.95


def test_servers_that_can_serve_all_do() -> None:
    assert mean_s("fleet-same-field") < 0.65 * mean_s("fleet-same-field", "local-only")
    assert mean_s("fleet-adjacent-fields") < 0.8 * mean_s("fleet-adjacent-fields", "local-only")


def test_a_server_that_cannot_serve_all_is_told_by_the_bound() -> None:
    bound = fly("fleet-overloaded-server").bound
    assert bound is not None and bound.shared_s > 1.2 * bound.free_s
    assert mean_s("fleet-overloaded-server") < mean_s("fleet-overloaded-server", "local-only")


def test_slow_drones_save_more_than_fast_ones() -> None:
    saved = fly("fleet-mixed").saved_s
    slow = [seconds for name, seconds in saved.items() if name.startswith("slow")]
    fast = [seconds for name, seconds in saved.items() if name.startswith("fast")]
    assert len(slow) == len(fast) == 4 and min(slow) > 2 * max(fast)


def test_three_vanish_and_what_they_held_comes_free() -> None:
    fleet = fly("fleet-vanishing")
    assert [name for name, each in fleet.drones.items() if each.vanished] == ["d2", "d5", "d6"]
    left = [value for value in fleet.drones.values() if not value.vanished]
    assert all(sum(each.totals.remote.values()) >= 20 for each in left)
