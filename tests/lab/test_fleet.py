"""Several drones of one simulation: when they are there, and what they leave behind."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest
from tests.scenarios import scenario, server

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import fleet_of, presences
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate, simulate_drones, simulate_fleet

LEASE_S = 30.0


def fleet(*drones: dict[str, Any], **tables: Any) -> DroneConfig:
    """Drones over the same small field, with one server of one slot in the middle of it, whose turns are long."""
    truth = {"slots": 1, "turn_s": 600.0}
    return scenario(server("s1", 40.0, 20.0, truth=truth), drone=list(drones), **tables)


def seen_of(config: DroneConfig) -> tuple[list[Run], list[Observation]]:
    seen: list[Observation] = []
    return simulate_fleet(fleet_of(config), there=presences(config), seen=seen), seen


def calls(run: Run) -> Sequence[schema.Call]:
    return [event for event in run.events if isinstance(event, schema.Call)]


def test_one_drone_of_a_fleet_flies_as_it_does_by_itself() -> None:
    alone = simulate(msgspec.structs.replace(fleet(), name="d1"))
    assert simulate_drones(fleet({"name": "d1"}))["d1"].log() == alone.log()


def test_the_first_drones_chance_is_the_files() -> None:
    noise = {"call": 0.1, "leg": 0.1}
    alone = simulate(msgspec.structs.replace(fleet(noise=noise), name="d1"))
    runs = simulate_drones(fleet({"name": "d1"}, {"name": "d2"}, noise=noise, policy={"name": "local-only"}))
    legs = [
        [event for event in run.events if isinstance(event, schema.SetOff)] for run in (alone, *runs.values())
    ]
    times_s = [[after.t - before.t for before, after in itertools.pairwise(own)] for own in legs]
    assert runs["d1"].result.mission_time_s != pytest.approx(runs["d2"].result.mission_time_s)
    assert times_s[1] != pytest.approx(times_s[2])


def test_a_drone_departs_later_and_its_mission_counts_from_then() -> None:
    soon, late = simulate_drones(
        fleet({"name": "d1"}, {"name": "d2", "departs_s": 100.0}, policy={"name": "local-only"})
    ).values()
    assert late.events[0].t == 100.0
    assert late.result.mission_time_s == pytest.approx(soon.result.mission_time_s)
    assert [event.t - 100.0 for event in late.events] == pytest.approx([event.t for event in soon.events])


def test_a_drone_that_vanishes_says_nothing_more_and_its_lease_runs_out() -> None:
    config = fleet({"name": "d1", "vanishes_s": 60.0}, {"name": "d2"})
    (gone, other), seen = seen_of(config)
    assert gone.vanished and not gone.result.completed
    assert gone.failure == "the drone vanished at 60 s, as its vanishes_s says"
    assert max(event.t for event in gone.events) <= 60.0
    assert not isinstance(gone.events[-1], schema.MissionEnded)
    assert max(each.t for each in seen if each.drone == "d1") <= 60.0
    assert not other.vanished and other.result.completed
    used_s = [call.at_s for call in calls(other) if call.place == "s1"]
    assert min(used_s) > 60.0
    kept = [each for each in seen if each.drone == "d1" and each.event == "asked"]
    assert min(used_s) >= kept[-1].t + LEASE_S - 1.0


def test_a_server_computes_for_a_drone_that_vanished_what_it_had_asked_for() -> None:
    slow = {"remote_call_s": {"light": 4.0, "heavy": 4.0}, "truth": {"slots": 2}}
    drones = [{"name": "d1"}, {"name": "d2"}]
    policy = {"name": "location-aware"}
    config = scenario(server("s1", 40.0, 20.0, **slow), drone=drones, policy=policy)
    (_, second), seen = seen_of(config)
    served = [each for each in seen if each.event == "served"]
    queued = next(
        after
        for before, after in itertools.pairwise(served)
        if (before.drone, after.drone) == ("d1", "d2") and after.t == pytest.approx(before.t + 4.0)
    )
    drones[0]["vanishes_s"] = queued.t - 3.0  # type: ignore[assignment]
    gone, left = simulate_drones(
        scenario(server("s1", 40.0, 20.0, **slow), drone=drones, policy=policy)
    ).values()
    assert gone.vanished
    answered = next(call for call in calls(second) if call.t == pytest.approx(queued.t + 4.0))
    assert answered in calls(left)


def test_a_drone_that_is_home_before_it_would_vanish_has_not() -> None:
    (run,) = simulate_drones(fleet({"name": "d1", "vanishes_s": 80_000.0})).values()
    assert run.result.completed and not run.vanished and run.failure == ""


def test_the_same_fleet_flies_the_same_way_twice() -> None:
    config = fleet(
        {"name": "d1"},
        {"name": "d2", "departs_s": 7.0},
        {"name": "d3", "vanishes_s": 90.0},
        noise={"call": 0.1},
    )
    logs = [[run.log() for run in simulate_drones(config).values()] for _ in range(2)]
    assert logs[0] == logs[1]


def test_one_mission_of_several_drones_is_refused() -> None:
    with pytest.raises(UsageError, match="the scenario has 2 drones, and this is for one"):
        simulate(fleet({"name": "d1"}, {"name": "d2"}))
