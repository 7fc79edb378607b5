"""Simulated missions of one drone, or of several at the same time: from a scenario to their results."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config, fleet_of
from upwash.config.places import coverage_kept, demands_kept
from upwash.errors import UsageError
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import Event
from upwash.lab.bounds import bound_of, bounds_of
from upwash.lab.least_time import Bound, FleetBound
from upwash.lab.outcome import fleet_outcome
from upwash.lab.run import Run, simulate_drones
from upwash.lab.run import simulate as fly
from upwash.lab.scenario import name_of, scenario_tables, told


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation(RunResult):
    """One simulated mission: its result, the least times that were possible, and its events.

    `failure` says why it was not completed, "" if it was; then there is no bound. `vanished` is whether the scenario
    had the drone vanish. `configuration` has the scenario's tables, without what may have secrets; for one of several
    drones it is empty, as `FleetSimulation` has them.
    """

    scenario: str
    seed: int
    failure: str
    vanished: bool = False
    bound: Bound | None
    events: Sequence[Event] = field(repr=False)
    configuration: Mapping[str, Any] = field(repr=False, default_factory=dict)


def simulate(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
    keep_coverage: bool = False,
    keep_demands: bool = False,
) -> Simulation:
    """Simulates one mission on virtual time: the same scenario and seed give the same mission.

    The scenario is a TOML file, or its tables as a dict, whose paths count from the current folder. A policy or a
    seed stands in for the scenario's, and `overrides` for other values of it, by keys such as `server.s1.range_m`:
    those of `upwash campaign --set`. With `keep_coverage` the scenario's `network.coverage_map` is written at the
    end, and with `keep_demands` its `policy.demand_map`, as by a flight.

    ConfigError for a scenario that cannot be flown, UsageError for what cannot be simulated, and MissionFailed for a
    mission program with a bug. What else ends a mission early is the result's `failure`. A scenario of several drones
    is for `simulate_fleet`.
    """
    document, file = scenario_tables(scenario, policy=policy, seed=seed, overrides=overrides)
    config, name = drone_config(document, file), name_of(scenario)
    if config.drones:
        has = f"{name} has [[drone]] tables ({len(config.drones)})"
        raise UsageError(f"{has}, and this simulates one mission: call simulate_fleet")
    if keep_coverage and config.network.coverage_map is None:
        raise UsageError(f"{name} names no file for its coverage map: give network.coverage_map")
    if keep_demands and config.policy.demand_map is None:
        raise UsageError(f"{name} names no file for its map of demands: give policy.demand_map")
    run = fly(config)
    if keep_demands and run.demand_map is not None:
        demands_kept(config, run.demand_map)
    if keep_coverage and run.coverage is not None:
        coverage_kept(config, run.coverage)
    simulation = simulation_of(run, config, bound_of(run, config), scenario=name)
    return replace(simulation, configuration=told(document))


def simulation_of(run: Run, config: DroneConfig, bound: Bound | None, *, scenario: str) -> Simulation:
    """The simulation of that run."""
    result = {field.name: getattr(run.result, field.name) for field in fields(run.result)}
    return Simulation(
        **result | {"policy": config.policy.label},  # also of a mission that never began
        scenario=scenario,
        seed=config.seed,
        failure=run.failure,
        vanished=run.vanished,
        bound=bound,
        events=run.events.as_read(),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSimulation:
    """Several missions at the same time, by drone, and their common results; times in seconds.

    `mean_s` and `worst_s` are of the completed missions, None without any. `saved_s` is what each drone saved against
    flying alone with every call on the drone. `jain` says how even that is: 1 if all saved the same, 1/n if one of n
    saved all. `bound` is the least possible mean.
    """

    drones: Mapping[str, Simulation]
    scenario: str
    seed: int
    mean_s: float | None
    worst_s: float | None
    saved_s: Mapping[str, float]
    jain: float | None
    bound: FleetBound | None
    configuration: Mapping[str, Any] = field(repr=False, default_factory=dict)

    @property
    def failures(self) -> dict[str, str]:
        """By drone, why a mission was not completed, except of drones that the scenario had vanish."""
        return {
            name: drone.failure for name, drone in self.drones.items() if drone.failure and not drone.vanished
        }


def simulate_fleet(
    scenario: str | os.PathLike[str] | Mapping[str, object],
    *,
    policy: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
) -> FleetSimulation:
    """Simulates the missions of all drones of a scenario at the same time; without any `[[drone]]` that is one.

    Its arguments and errors are those of `simulate`. A policy that is given is every drone's.
    """
    document, file = scenario_tables(scenario, policy=policy, seed=seed, overrides=overrides)
    config = drone_config(document, file)
    fleet, runs = fleet_of(config), simulate_drones(config)
    bounds, of_all = bounds_of(list(runs.values()), fleet)
    outcome = fleet_outcome(runs, config, of_all)
    return FleetSimulation(
        drones={
            drone.name: simulation_of(runs[drone.name], drone, bound, scenario=name_of(scenario))
            for drone, bound in zip(fleet, bounds, strict=True)
        },
        scenario=name_of(scenario),
        seed=config.seed,
        mean_s=outcome.mean_s,
        worst_s=outcome.worst_s,
        saved_s=outcome.saved_s,
        jain=outcome.jain,
        bound=outcome.bound,
        configuration=told(document),
    )
