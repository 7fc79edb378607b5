"""What the flight of a scenario came to in a few numbers, whether one drone flew or several at the same time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from upwash.config import DroneConfig, fleet_of
from upwash.eventlog.results import EnergyTotals, Totals
from upwash.lab.bounds import bound_of, bounds_of
from upwash.lab.fleet import outcome_of
from upwash.lab.run import Run, simulate, simulate_drones


@dataclass(frozen=True, slots=True)
class Together:
    """What only several drones have: how many completed their missions, the slowest, and how evenly they saved."""

    completed: int
    worst_s: float
    jain: float
    bound_shared_s: float


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """One flight, or one of several drones: then times, bounds and energy are means over those that completed theirs.

    The counts of `totals` are of all calls of all drones. `failure` says why it was not completed, which it is where
    only drones are missing that vanish as the scenario has it. Bounds are None without a completed mission.
    """

    policy: str
    completed: bool
    failure: str
    mission_time_s: float | None
    totals: Totals
    bound_s: float | None
    bound_with_joins_s: float | None
    energy: EnergyTotals | None
    fleet: Together | None = None

    @property
    def least_s(self) -> float | None:
        """The bound that it is held against: what servers can compute at a time counts among several drones."""
        return self.bound_s if self.fleet is None else self.fleet.bound_shared_s


def fly(config: DroneConfig) -> FlightOutcome:
    """Flies the scenario; raises what `simulate` raises."""
    return _fly_fleet(config) if config.drones else _fly_one(config)


def _fly_one(config: DroneConfig) -> FlightOutcome:
    run = simulate(config)
    bound = bound_of(run, config)
    return FlightOutcome(
        policy=run.result.policy,
        completed=run.result.completed and not run.failure,
        failure=run.failure,
        mission_time_s=run.result.mission_time_s,
        totals=run.result.totals,
        bound_s=bound.free_s if bound else None,
        bound_with_joins_s=bound.with_joins_s if bound else None,
        energy=run.result.energy,
    )


def _fly_fleet(config: DroneConfig) -> FlightOutcome:
    fleet, runs = fleet_of(config), simulate_drones(config)
    _, bound = bounds_of(list(runs.values()), fleet)
    found = outcome_of(runs, config)
    failure = _failure(runs)
    completed = [run.result for run in runs.values() if run.result.completed]
    together = None
    if bound is not None and found.worst_s is not None:
        jain = 1.0 if found.jain is None else found.jain
        together = Together(len(completed), found.worst_s, jain, bound.shared_s)
    return FlightOutcome(
        policy=" ".join(dict.fromkeys(each.policy.name for each in fleet)),
        completed=together is not None and not failure,
        failure=failure,
        mission_time_s=found.mean_s,
        totals=_sums([run.result.totals for run in runs.values()]),
        bound_s=bound.free_s if bound else None,
        bound_with_joins_s=bound.with_joins_s if bound else None,
        energy=_means([result.energy for result in completed if result.energy is not None]),
        fleet=together,
    )


def _failure(runs: Mapping[str, Run]) -> str:
    """Why drones failed that were not to vanish, or that none is left."""
    failed = [f"{name}: {run.failure}" for name, run in runs.items() if run.failure and not run.vanished]
    if not failed and all(run.vanished for run in runs.values()):
        return "every drone vanished"
    return "; ".join(failed)


def _sums(totals: Sequence[Totals]) -> Totals:
    remote: dict[str, int] = {}
    for each in totals:
        for server, count in each.remote.items():
            remote[server] = remote.get(server, 0) + count
    counts = {
        field.name: sum(getattr(each, field.name) for each in totals)
        for field in dataclasses.fields(Totals)
        if field.name != "remote"
    }
    return Totals(remote=dict(sorted(remote.items())), **counts)


def _means(drawn: Sequence[EnergyTotals]) -> EnergyTotals | None:
    if not drawn:
        return None
    names = [field.name for field in dataclasses.fields(EnergyTotals) if field.name != "battery_wh"]
    return EnergyTotals(
        battery_wh=drawn[0].battery_wh,
        **{name: fmean(getattr(each, name) for each in drawn) for name in names},
    )
