"""Several simulated missions at the same time: from a scenario to what they came to, all together."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean

from upwash.config import DroneConfig, fleet_of, presences
from upwash.core.planning.bound import FleetBound
from upwash.lab.bounds import bounds_of
from upwash.lab.fairness import jain, saved_s
from upwash.lab.run import Run, simulate_drones
from upwash.lab.scenario import name_of, read_scenario
from upwash.lab.simulation import Simulation, simulation_of


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSimulation:
    """Several missions at the same time, each by its drone's name, and what they came to; times in seconds.

    `mean_s` and `worst_s` are of the missions that were completed, and None where there are none. `saved_s` is what
    each of them saved against flying alone with every call on the drone, and `jain` says how even that is: 1 where
    all saved the same, one n-th where one of n saved all. `bound` is the least mean that there could have been.
    """

    drones: Mapping[str, Simulation]
    scenario: str
    seed: int
    mean_s: float | None
    worst_s: float | None
    saved_s: Mapping[str, float]
    jain: float | None
    bound: FleetBound | None

    @property
    def failures(self) -> dict[str, str]:
        """By name, why missions were not completed, but for those of drones that vanished as the scenario has it."""
        return {
            name: each.failure for name, each in self.drones.items() if each.failure and not each.vanished
        }


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """What the missions came to that were completed; as FleetSimulation has it."""

    mean_s: float | None
    worst_s: float | None
    saved_s: Mapping[str, float]
    jain: float | None


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
    config = read_scenario(scenario, policy=policy, seed=seed, overrides=overrides)
    fleet, runs = fleet_of(config), simulate_drones(config)
    bounds, of_all = bounds_of(list(runs.values()), fleet)
    outcome = outcome_of(runs, config)
    return FleetSimulation(
        drones={
            each.name: simulation_of(runs[each.name], each, bound, scenario=name_of(scenario))
            for each, bound in zip(fleet, bounds, strict=True)
        },
        scenario=name_of(scenario),
        seed=config.seed,
        mean_s=outcome.mean_s,
        worst_s=outcome.worst_s,
        saved_s=outcome.saved_s,
        jain=outcome.jain,
        bound=of_all,
    )


def outcome_of(runs: Mapping[str, Run], config: DroneConfig) -> FleetOutcome:
    """What the runs of the scenario's drones came to, all together."""
    times_s = [run.result.mission_time_s for run in runs.values() if run.result.completed]
    saved = saved_s(runs, fleet_of(config), presences(config))
    return FleetOutcome(
        mean_s=fmean(times_s) if times_s else None,
        worst_s=max(times_s, default=None),
        saved_s=saved,
        jain=jain(saved.values()),
    )
