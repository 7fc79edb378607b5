"""Checks a scenario of several drones: flies them all in simulation, and holds the file against what came of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from upwash.config import (
    Document,
    DroneConfig,
    coverage_of,
    drone_config,
    fleet_of,
    plan_notices,
    server_areas,
    waypoints,
)
from upwash.drone.preparation import order_of
from upwash.eventlog import schema
from upwash.lab import processes
from upwash.lab.run import Run, simulate_drones
from upwash.lab.simulation import with_policy
from upwash.missions.bundled import load_specs
from upwash.preflight.check import beliefs
from upwash.preflight.coverage import coverage, uncovered
from upwash.preflight.prediction import AS_CONFIGURED, LOCAL_ONLY, Prediction, changed
from upwash.preflight.warnings import PreflightWarning, warnings
from upwash.support.confidence import mean_of


class DroneForecast(Struct, frozen=True, kw_only=True):
    """What is known of one drone's mission among the others; no `mission_time_s` of one that is to vanish on it.

    `order` is as in `Check`.
    """

    drone: str
    waypoints: int
    order: str = ""
    uncovered: tuple[int, ...]
    predictions: tuple[Prediction, ...]
    warnings: tuple[PreflightWarning, ...]


class AskedServer(Struct, frozen=True):
    """By how many of the drones a server is asked for a slot, of those who come into its range."""

    server: str
    in_range_of: int
    asked_by: int


class FleetCheck(Struct, frozen=True, kw_only=True):
    """What was found: the one object that `upwash check --json` prints for several drones."""

    config: str
    drones: tuple[DroneForecast, ...]
    servers: tuple[AskedServer, ...]
    notices: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[PreflightWarning, ...]:
        """Those of all drones; what is said of several in the same words is said once, with their names."""
        names: dict[PreflightWarning, list[str]] = {}
        for each in self.drones:
            for warning in each.warnings:
                names.setdefault(warning, []).append(each.drone)
        return tuple(
            PreflightWarning(warning.kind, f"{', '.join(of)}: {warning.text}")
            for warning, of in names.items()
        )


class _Flight(Struct, frozen=True):
    """What one process does in one go."""

    document: Document
    file: Path
    seed: int
    local_only: bool


class _Flown(Struct, frozen=True):
    """What it came to."""

    case: str
    seed: int
    runs: Mapping[str, Run]


def check_fleet(document: Document, file: Path, *, seeds: int, workers: int | None) -> FleetCheck:
    """Flies the drones with every call on them and as configured, with the seeds 1 to `seeds`."""
    document = changed(document)
    config = drone_config(document, file)
    flights = [
        _Flight(document, file, seed, local_only)
        for seed in range(1, seeds + 1)
        for local_only in (True, False)
    ]
    with processes.here_first(_fly, flights, workers=workers) as results:
        flown = sorted(results, key=lambda each: each.seed)
    return FleetCheck(
        config=str(file),
        drones=tuple(_forecast(each, flown) for each in fleet_of(config)),
        servers=tuple(_asked(server.name, flown) for server in config.servers),
        notices=tuple(plan_notices(config)),
    )


def _fly(flight: _Flight) -> _Flown:
    config = msgspec.structs.replace(drone_config(flight.document, flight.file), seed=flight.seed)
    if flight.local_only:
        return _Flown(LOCAL_ONLY, flight.seed, simulate_drones(with_policy(config, LOCAL_ONLY)))
    return _Flown(AS_CONFIGURED, flight.seed, simulate_drones(config))


def _forecast(config: DroneConfig, flown: Sequence[_Flown]) -> DroneForecast:
    cases = (LOCAL_ONLY,) if config.policy.name == LOCAL_ONLY else (LOCAL_ONLY, AS_CONFIGURED)
    runs = {case: [each.runs[config.name] for each in flown if each.case == case] for case in cases}
    alone = runs[LOCAL_ONLY][0]
    places = [waypoint.position for waypoint in waypoints(config.mission)]
    covered = coverage(
        places,
        server_areas(config),
        alone.range_intervals,
        ended_s=alone.events[-1].t,
        known=coverage_of(config),
    )
    predictions = tuple(_prediction(config, case, its_runs) for case, its_runs in runs.items())
    found = warnings(config, covered, list(beliefs(config, alone)), predictions)
    return DroneForecast(
        drone=config.name,
        waypoints=len(places),
        order=order_of(config, load_specs(config.services)).why,
        uncovered=uncovered(len(places), covered),
        predictions=predictions,
        warnings=tuple(found),
    )


def _prediction(config: DroneConfig, case: str, runs: Sequence[Run]) -> Prediction:
    times_s = [run.result.mission_time_s for run in runs if run.result.completed]
    drawn_wh = [run.result.energy.total_wh for run in runs if run.result.completed and run.result.energy]
    lighter = [run.result.totals.lighter for run in runs if run.result.completed]
    time_s, energy_wh = (mean_of(values) if values else None for values in (times_s, drawn_wh))
    return Prediction(
        case=case,
        missions=len(runs),
        mission_time_s=time_s.value if time_s else None,
        margin_s=time_s.margin if time_s and time_s.count > 1 else None,
        failures=tuple(run.failure for run in runs if run.failure and not run.vanished),
        energy_wh=energy_wh.value if energy_wh else None,
        energy_margin_wh=energy_wh.margin if energy_wh and energy_wh.count > 1 else None,
        lighter=mean_of(lighter).value if config.mission.lighter and lighter else None,
    )


def _asked(server: str, flown: Sequence[_Flown]) -> AskedServer:
    as_configured = [each.runs for each in flown if each.case == AS_CONFIGURED]
    in_range = {
        name
        for runs in as_configured
        for name, run in runs.items()
        if any(stay.server == server for stay in run.range_intervals)
    }
    asking = {name for runs in as_configured for name, run in runs.items() if server in _selected(run)}
    return AskedServer(server, len(in_range), len(asking))


def _selected(run: Run) -> Iterator[str]:
    return (event.server for event in run.events if isinstance(event, schema.Selected))
