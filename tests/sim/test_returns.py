"""Simulated returns that hover, or end at a rally point: the program lands them, with the reserve, and says where."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.drone.test_safe_ends import SCENARIO

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.world import FaultConfig
from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate
from upwash.sim.faults import Faults

HOVERS = {"target": "autopilot", "kind": "hovers"}
RALLY = {"target": "autopilot", "kind": "rally", "moved_m": [250.0, 60.0, 0.0]}


def scenario(*faults: dict[str, Any], **tables: dict[str, Any]) -> DroneConfig:
    document = {name: {**SCENARIO.get(name, {}), **table} for name, table in tables.items()}
    return drone_config({**SCENARIO, **document, "fault": list(faults)}, Path("scenario.toml"))


def of(run: Run, kind: type[schema.Event]) -> list[Any]:
    return [event for event in run.events if isinstance(event, kind)]


@pytest.mark.parametrize("profile", [{}, {"profile": "arducopter"}, {"profile": "px4"}])
def test_a_return_that_hovers_is_landed(profile: dict[str, str]) -> None:
    run = simulate(scenario(HOVERS, vehicle=profile))
    assert run.failure == ""
    (hovers,), (landed,) = of(run, schema.ReturnHovers), of(run, schema.Landed)
    assert hovers.position == Position(0.0, 0.0, 5.0)
    assert (landed.position, landed.at, landed.from_home_m) == (Position(0.0, 0.0), "home", 0.0)
    assert landed.t - hovers.t <= 30.0


def test_without_the_fault_nothing_is_said_of_a_hover() -> None:
    assert not of(simulate(scenario()), schema.ReturnHovers)


def test_a_return_ends_at_the_rally_point_and_says_how_far_that_is_from_home() -> None:
    run = simulate(scenario(RALLY, {**RALLY, "moved_m": [-900.0, 0.0, 0.0]}))
    (landed,) = of(run, schema.Landed)
    assert landed.position == Position(250.0, 60.0)
    assert (landed.at, landed.from_home_m) == ("rally point 1", 257.1)
    (doubt,) = of(run, schema.SiteDoubt)
    assert "ends at the vehicle's rally point 1, 257 m from home" in doubt.why
    assert of(run, schema.LimitsRead)[0].rally == [Position(250.0, 60.0), Position(-900.0, 0.0)]


@pytest.mark.parametrize("faults", [[HOVERS], [RALLY], [HOVERS, {**RALLY, "moved_m": [-600.0, 0.0, 0.0]}]])
def test_the_reserve_is_left_at_touchdown(faults: list[dict[str, Any]]) -> None:
    config = scenario(
        *faults, mission={"reserve_s": 60.0}, vehicle={"profile": "arducopter", "endurance_s": 230.0}
    )
    run = simulate(config)
    assert "s to home need" in run.failure
    flown_s = of(run, schema.Landed)[0].t - of(run, schema.Armed)[0].t
    assert 230.0 - flown_s >= 60.0
    assert of(run, schema.Energy)[-1].t > of(run, schema.Stopping)[0].t, "it is watched on the way down"


def test_only_the_autopilot_has_returns() -> None:
    with pytest.raises(UsageError, match="link:s1 cannot be hovers"):
        Faults([FaultConfig(target="link:s1", kind="hovers")])
