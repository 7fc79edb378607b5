"""`upwash.simulate`, `read_log` and `read_result`: what a notebook gets."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import upwash
from upwash.cli.main import main
from upwash.eventlog import schema
from upwash.eventlog.results import as_json

ROOT = Path(__file__).parents[2]
PATROL = ROOT / "examples" / "patrol.toml"
PROGRAM = ROOT / "examples" / "patrol.py"


def tables() -> dict[str, Any]:
    """The patrol's, as a notebook may hold them: with tuples, paths and numpy's numbers."""
    document = tomllib.loads(PATROL.read_text().replace("patrol.py:", f"{PROGRAM}:"))
    document["mission"]["waypoints_m"] = tuple(document["mission"]["waypoints_m"])
    document["server"][0]["range_m"] = np.float64(40.0)
    document["seed"] = np.int64(1)
    return document


def test_the_command_prints_what_a_notebook_gets(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(PATROL), "--policy", "local-only", "--seed", "7", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed.pop("upwash")["version"] == version("upwash")
    simulation = upwash.simulate(str(PATROL), policy="local-only", seed=7)
    assert printed == {name: as_json(getattr(simulation, name)) for name in printed}
    assert (simulation.policy, simulation.seed, simulation.failure) == ("local-only", 7, "")
    assert simulation.totals.local == len(simulation.calls) == 5
    assert simulation.bound is not None
    assert 0 < simulation.bound.free_s <= simulation.bound.with_joins_s < simulation.mission_time_s


def test_what_it_came_to_is_read_from_its_events_and_from_its_log(tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    assert main(["simulate", str(PATROL), "--json", "--log", str(log)]) == 0
    simulation = upwash.simulate(PATROL)
    named, *events = upwash.read_log(str(log))
    assert isinstance(named, schema.Simulated) and named.scenario == str(PATROL)
    assert events == simulation.events
    for result in (upwash.read_result(events), upwash.read_result(simulation.events)):
        assert result == upwash.RunResult(
            **{field.name: getattr(simulation, field.name) for field in dataclasses.fields(upwash.RunResult)}
        )
    assert events[-1].t >= simulation.mission_time_s > 0


def test_a_result_can_be_put_into_a_table_and_not_be_changed() -> None:
    simulation = upwash.simulate(PATROL)
    rows = [dataclasses.asdict(call) for call in simulation.calls]
    assert [row["waypoint"] for row in rows] == [0, 1, 2, 3, 4]
    assert {type(value) for row in rows for value in row.values()} <= {int, str, float, bool, type(None)}
    with pytest.raises(dataclasses.FrozenInstanceError):
        simulation.mission_time_s = 0.0  # type: ignore[misc]
    assert len(repr(simulation)) < 1000  # which a notebook prints


def test_tables_are_flown_as_their_file_is() -> None:
    of_file, of_tables = upwash.simulate(PATROL), upwash.simulate(tables())
    assert of_tables.events == of_file.events
    assert (of_file.scenario, of_tables.scenario) == ("patrol", "scenario")


def test_other_values_stand_in_for_the_scenarios_and_leave_it_as_it_is() -> None:
    document = tables()
    for scenario in (PATROL, document):
        narrow = upwash.simulate(scenario, overrides={"server.s1.range_m": np.float64(1.0), "seed": 5})
        assert narrow.totals.remote == {}
        assert narrow.seed == 5
    assert document == tables()


def test_it_can_be_simulated_where_an_event_loop_runs_as_in_a_notebook() -> None:
    async def cell() -> upwash.Simulation:
        return upwash.simulate(PATROL)

    assert asyncio.run(cell()) == upwash.simulate(PATROL)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"policy": "look-ahaed"}, "policy.name: expected one of"),
        ({"seed": 2**70}, "seed: expected a number that fits 64 bits"),
        ({"overrides": {"server.s9.range_m": 1.0}}, 'server: there is no "s9"; allowed: s1'),
        ({"overrides": {"server.s1.range_m": float("inf")}}, "server.s1.range_m: expected a finite number"),
        ({"overrides": {"server.s1.range_m": object()}}, "server.s1.range_m: expected numbers, strings"),
    ],
)
def test_what_cannot_be_flown_is_an_error_that_names_the_key(given: dict[str, Any], said: str) -> None:
    for scenario, name in ((PATROL, str(PATROL)), (tables(), "scenario")):
        with pytest.raises(upwash.ConfigError) as raised:
            upwash.simulate(scenario, **given)
        assert str(raised.value).startswith(f"{name}: {said}")


def test_a_mission_that_ends_early_says_why_and_one_with_a_bug_raises(tmp_path: Path) -> None:
    program = tmp_path / "missions.py"
    program.write_text(
        "def hasty(drone):\n    drone.autopilot.goto(drone.plan[0])\n\ndef buggy(drone):\n    1 / 0\n"
    )
    hasty = upwash.simulate(PATROL, overrides={"mission.program": f"{program}:hasty"})
    assert not hasty.completed
    assert hasty.bound is None
    assert "goto: the vehicle is on the ground" in hasty.failure
    with pytest.raises(upwash.MissionFailed, match="ZeroDivisionError"):
        upwash.simulate(PATROL, overrides={"mission.program": f"{program}:buggy"})


def test_noise_of_joins_and_starts_is_of_each_by_itself_and_leaves_calls_and_legs_as_they_are() -> None:
    still, joins, both = (
        upwash.simulate(PATROL, overrides={"noise.call": 0.1, "noise.leg": 0.1, **more})
        for more in ({}, {"noise.join": 0.3}, {"noise.join": 0.3, "noise.start": 0.3})
    )
    assert _after(still, schema.Selected, schema.Joined) == pytest.approx([2.0])
    assert _after(joins, schema.Selected, schema.Joined) != pytest.approx([2.0])
    assert _after(both, schema.Selected, schema.Joined) == _after(joins, schema.Selected, schema.Joined)
    assert _after(joins, schema.Joined, schema.Started) == pytest.approx([2.0])
    assert _after(both, schema.Joined, schema.Started) != pytest.approx([2.0])
    for place in ("local", "s1"):
        delays = [
            [call.delay_s - call.waited_s for call in each.calls if call.place == place]
            for each in (still, joins, both)
        ]
        shared = min(map(len, delays))
        assert delays[0][:shared] == pytest.approx(delays[1][:shared])
        assert delays[1][:shared] == pytest.approx(delays[2][:shared])


def _after(simulation: upwash.Simulation, began: type[Any], ended: type[Any]) -> list[float]:
    """How long after the last `began` each `ended` came."""
    since, took = 0.0, []
    for event in simulation.events:
        if isinstance(event, began):
            since = event.t
        if isinstance(event, ended):
            took.append(event.t - since)
    return took
