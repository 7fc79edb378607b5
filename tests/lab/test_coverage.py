"""Servers without a range: what one flight measures is worth something to the next."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import upwash
from upwash.eventlog import schema
from upwash.lab.campaigns.campaign import in_processes
from upwash.preflight.check import check, read_plan

EXAMPLE = Path(__file__).parents[2] / "examples" / "lte.toml"


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    return Path(shutil.copy(EXAMPLE, tmp_path))


def failed_calls(simulation: upwash.Simulation) -> int:
    return sum(isinstance(event, schema.RemoteFailed) for event in simulation.events)


def test_the_second_flight_is_better_than_the_first(scenario: Path) -> None:
    first = upwash.simulate(scenario, keep_coverage=True)
    second = upwash.simulate(scenario, keep_coverage=True)
    assert failed_calls(first) > 0
    assert failed_calls(second) == 0
    assert second.mission_time_s < first.mission_time_s
    assert second.bound is not None
    assert second.mission_time_s <= 1.001 * second.bound.free_s


def test_without_being_told_to_a_simulation_writes_no_map(scenario: Path) -> None:
    upwash.simulate(scenario)
    assert list(scenario.parent.iterdir()) == [scenario]


def test_a_map_is_kept_only_where_there_is_a_file_for_it(scenario: Path) -> None:
    scenario.write_text(scenario.read_text().replace('coverage_map = "lte.coverage.json"', ""))
    with pytest.raises(
        upwash.UsageError, match=r"names no file for its coverage map: give network\.coverage_map"
    ):
        upwash.simulate(scenario, keep_coverage=True)


def test_the_log_says_what_is_known_before_and_what_is_measured(scenario: Path) -> None:
    upwash.simulate(scenario, keep_coverage=True)
    second = upwash.simulate(scenario)
    (planned,) = [event for event in second.events if isinstance(event, schema.Planned)]
    assert planned.ranges == {}
    known = planned.measured["s1"]
    assert any(place.answered == 0 for place in known)
    assert any(place.call_s == {"detector.process_photo[heavy]": 1.0} for place in known)
    measured = [event.place for event in second.events if isinstance(event, schema.PlaceMeasured)]
    assert measured
    assert all(place.flights_ago == 0 for place in measured)


def test_a_check_says_where_the_server_was_reached(scenario: Path) -> None:
    upwash.simulate(scenario, keep_coverage=True)
    text = scenario.read_text()
    scenario.write_text(text[: text.index("[server.truth]")])  # so that nothing but the map is known
    found = check(read_plan(scenario), seeds=1, fly=in_processes(1))
    (server,) = found.servers
    assert server.range_m is None
    assert set(server.waypoints) >= {0, 1, 2, 3}
    assert 6 in found.uncovered
    predicted = {prediction.case: prediction.mission_time_s for prediction in found.predictions}
    again = upwash.simulate(scenario)
    assert predicted["as configured"] == pytest.approx(again.mission_time_s)
    assert again.totals.local > 10
