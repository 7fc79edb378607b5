"""`upwash.simulate_fleet` and `upwash simulate` with several drones: what a notebook and a terminal get."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import upwash
from upwash.cli.main import main
from upwash.eventlog import schema
from upwash.eventlog.results import as_json
from upwash.lab.outcome import jain
from upwash.support.text import lasting

SCENARIO = """
seed = 5

[mission]
grid = { columns = 4, rows = 3, spacing_m = 20.0 }

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 30.0
north_m = 20.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[[drone]]
name = "d1"

[[drone]]
name = "d2"
departs_s = 40.0
waypoints_m = [[0, 0], [20, 0], [40, 0]]
policy = "local-only"

[[drone]]
name = "d3"
vanishes_s = 50.0
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    file = tmp_path / "three.toml"
    file.write_text(SCENARIO)
    return file


def tables(drones: list[dict[str, Any]], server: dict[str, Any], **other: Any) -> dict[str, Any]:
    """Drones over a small field with one server in it, or with two at its ends."""
    at = {"range_m": 70.0, "remote_call_s": {"light": 0.5, "heavy": 2.0}, **server}
    return {
        "mission": {"grid": {"columns": 3, "rows": 3, "spacing_m": 20.0}},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
        "server": [
            {"name": "s1", "east_m": 0.0, "north_m": 20.0, **at},
            {"name": "s2", "east_m": 60.0, "north_m": 20.0, **at},
        ],
        "drone": drones,
        **other,
    }


def test_each_drone_is_a_simulation_and_all_together_are_their_means(scenario: Path) -> None:
    fleet = upwash.simulate_fleet(scenario)
    first, second, gone = fleet.drones.values()
    assert (fleet.scenario, fleet.seed, list(fleet.drones)) == ("three", 5, ["d1", "d2", "d3"])
    assert (first.policy, second.policy, first.seed) == ("look-ahead", "local-only", 5)
    assert gone.vanished and not gone.completed and gone.bound is None and fleet.failures == {}
    assert fleet.mean_s == (first.mission_time_s + second.mission_time_s) / 2
    assert fleet.worst_s == max(first.mission_time_s, second.mission_time_s)
    alone = upwash.simulate(scenario, policy="local-only", overrides={"drone": []}).mission_time_s
    assert fleet.saved_s == pytest.approx({"d1": alone - first.mission_time_s, "d2": 0.0}, abs=1e-5)
    assert fleet.saved_s["d1"] > 50
    assert fleet.jain == pytest.approx(0.5)
    assert first.bound is not None and second.bound is not None and fleet.bound is not None
    assert fleet.bound.free_s == pytest.approx((first.bound.free_s + second.bound.free_s) / 2)
    assert first.events == [event for event in first.events if event.t <= first.events[-1].t]


def test_a_scenario_of_one_drone_is_a_fleet_of_one() -> None:
    scenario = tables([], {})
    alone, fleet = upwash.simulate(scenario), upwash.simulate_fleet(scenario)
    assert list(fleet.drones) == ["drone"] and fleet.configuration == alone.configuration
    assert dataclasses.replace(fleet.drones["drone"], configuration=alone.configuration) == alone
    assert fleet.mean_s == fleet.worst_s == alone.mission_time_s
    assert fleet.jain == 1.0


def test_a_policy_that_is_given_is_every_drones(scenario: Path) -> None:
    fleet = upwash.simulate_fleet(scenario, policy="opportunistic")
    assert {value.policy for value in fleet.drones.values()} == {"opportunistic"}
    others = upwash.simulate_fleet(scenario, overrides={"policy.name": "opportunistic"})
    assert others.drones["d2"].policy == "local-only"


def test_where_no_mission_is_completed_there_is_nothing_to_average() -> None:
    fleet = upwash.simulate_fleet(tables([{"name": "d1", "vanishes_s": 5.0}], {}))
    assert (fleet.mean_s, fleet.worst_s, fleet.jain, fleet.bound) == (None, None, None, None)
    assert fleet.saved_s == {}


def test_what_was_saved_is_as_even_as_jains_index_says() -> None:
    assert jain([]) is None
    assert jain([5.0]) == jain([2.0, 2.0, 2.0]) == jain([0.0, 0.0]) == 1.0
    assert jain([3.0, 0.0, 0.0]) == pytest.approx(1 / 3)
    assert jain([4.0, -2.0]) == jain([4.0, 0.0]) == 0.5
    assert jain([1.0, 3.0]) == pytest.approx(16 / 20)


def test_one_simulation_of_several_drones_says_what_to_call(scenario: Path) -> None:
    with pytest.raises(upwash.UsageError, match=r"three has \[\[drone\]\] tables \(3\).*call simulate_fleet"):
        upwash.simulate(scenario)


def test_the_command_prints_a_result_for_each_drone(
    scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(scenario), "--json", "--seed", "9"]) == 0
    printed = json.loads(capsys.readouterr().out)
    fleet = upwash.simulate_fleet(scenario, seed=9)
    assert next(iter(printed)) == "drones"
    for name in ("mean_s", "worst_s", "jain", "saved_s", "seed", "bound"):
        assert printed[name] == msgspec.to_builtins(getattr(fleet, name))
    assert printed["drones"]["d3"]["vanished"] is True
    first = printed["drones"]["d1"]
    assert first == {name: as_json(getattr(fleet.drones["d1"], name)) for name in first}


def test_the_command_prints_a_row_for_each_drone_and_keeps_a_log_of_each(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(scenario), "--log", str(tmp_path / "flown.jsonl")]) == 0
    printed = capsys.readouterr().out
    fleet = upwash.simulate_fleet(scenario)
    for name, each in fleet.drones.items():
        (row,) = [line for line in printed.splitlines() if line.strip().startswith(name)]
        assert f"{sum(each.totals.remote.values())} of {each.totals.calls}" in row
        named, *events = upwash.read_log(tmp_path / f"flown-{name}.jsonl")
        assert isinstance(named, schema.Simulated) and named.seed == 5
        assert events == each.events
    assert fleet.mean_s is not None and fleet.worst_s is not None
    assert f"mean {lasting(fleet.mean_s)}, worst {lasting(fleet.worst_s)}" in printed
    assert "not counted, as they did not complete their missions: d3" in printed


def test_figures_of_several_drones_are_refused(scenario: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(scenario), "--figures", "there"]) == 2
    assert "--figures draws one mission" in capsys.readouterr().err


def test_a_drone_that_fails_is_named_and_the_others_count(
    tmp_path: Path, scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "missions.py"
    program.write_text(
        "def fly(drone):\n"
        "    if len(drone.plan) == 3:\n"
        "        drone.autopilot.goto(drone.plan[0])\n"
        "    drone.autopilot.arm()\n    drone.autopilot.takeoff(drone.altitude_m)\n"
        "    drone.autopilot.return_home_and_land()\n"
    )
    scenario.write_text(SCENARIO.replace("[mission]", f'[mission]\nprogram = "{program}:fly"'))
    assert main(["simulate", str(scenario)]) == 1
    said = capsys.readouterr()
    assert "d2 did not complete its mission: goto: the vehicle is on the ground" in said.err
    assert "not counted, as they did not complete their missions: d2" in said.out


# --- the bound ---------------------------------------------------------------------------------------------


def test_where_one_server_cannot_serve_all_the_bound_says_so() -> None:
    slow = {"remote_call_s": {"light": 3.0, "heavy": 3.0}, "truth": {"lanes": 1}}
    drones = [{"name": f"d{number}"} for number in range(20)]
    for lanes, share in (1, True), (20, False):
        slow["truth"] = {"lanes": lanes}
        fleet = upwash.simulate_fleet(tables(drones, slow))
        assert fleet.bound is not None and fleet.mean_s is not None
        assert fleet.bound.free_s <= fleet.bound.shared_s <= fleet.mean_s
        assert (fleet.bound.shared_s > 1.1 * fleet.bound.free_s) == share


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_no_fleet_beats_its_bounds(data: st.DataObject) -> None:
    draw = data.draw
    call_s = draw(st.sampled_from([0.2, 1.0, 3.0, 6.0]))
    truth = {
        "lanes": draw(st.integers(1, 3)),
        "slots": draw(st.sampled_from(["auto", 1, 2, 5])),
        "processing_s": {"light": 0.1, "heavy": draw(st.sampled_from([0.1, call_s]))},
        "remote_call_s": {"light": 0.2, "heavy": call_s},
    }
    drones = [
        {
            "name": f"d{number}",
            "departs_s": draw(st.sampled_from([0.0, 3.0, 60.0])),
            "local_call_s": {"heavy": draw(st.sampled_from([2.0, 10.0, 20.0]))},
            "policy": draw(st.sampled_from(["local-only", "opportunistic", "location-aware", "look-ahead"])),
        }
        for number in range(draw(st.integers(1, 6)))
    ]
    fleet = upwash.simulate_fleet(tables(drones, {"truth": truth}))
    assert fleet.bound is not None and fleet.mean_s is not None
    assert fleet.bound.free_s <= min(fleet.bound.with_joins_s, fleet.bound.shared_s) + 1e-6
    assert max(fleet.bound.with_joins_s, fleet.bound.shared_s) <= fleet.mean_s + 1e-6


def test_what_a_drone_saves_that_goes_on_before_answers_is_what_servers_save_it() -> None:
    # it draws its events by its seed, flown alone too
    mission = {"grid": {"columns": 3, "rows": 3, "spacing_m": 20.0}, "action_s": 9.0}
    events = {"probability": 0.4}
    goes = tables([], {}, policy={"stay_or_go": "go"}, mission=mission, event=events, seed=3)
    fleet = upwash.simulate_fleet(goes)
    alone = upwash.simulate(goes, policy="local-only")
    assert alone.totals.turns_back > 0
    assert fleet.saved_s["drone"] == pytest.approx(
        alone.mission_time_s - fleet.drones["drone"].mission_time_s
    )
