"""Checks a scenario of several drones, by simulating all of them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import UNSET, Struct, UnsetType
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config, fleet_of
from upwash.config.places import coverage_of, file_notices, server_areas, waypoints
from upwash.config.reading import Document
from upwash.drone.preparation import order_of
from upwash.eventlog import schema
from upwash.eventlog.narration import spans
from upwash.lab import processes
from upwash.lab.outcome import failure_of
from upwash.lab.run import Run, simulate, simulate_drones
from upwash.lab.scenario import with_policy
from upwash.lab.speed import with_speed
from upwash.missions.bundled import load_specs
from upwash.preflight.acts import demanding_share, told_acts
from upwash.preflight.check import CheckInput, beliefs
from upwash.preflight.display import print_findings
from upwash.preflight.prediction import (
    AS_CONFIGURED,
    LOCAL_ONLY,
    Prediction,
    changed,
    prediction_of,
)
from upwash.preflight.speed import SpeedCheck, check_speed, told_speed
from upwash.preflight.warnings import PreflightWarning, warnings
from upwash.preflight.waypoints import coverage, uncovered
from upwash.sim.chance import plays_a_part
from upwash.support.confidence import mean_or_none
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, lasting


class DroneForecast(Struct, frozen=True, kw_only=True):
    """One drone's mission among the others; no `mission_time_s` if the drone vanishes.

    `order` and `speed` are as in `MissionCheck`.
    """

    drone: str
    waypoints: int
    order: str = ""
    speed: SpeedCheck | UnsetType = UNSET
    uncovered: tuple[int, ...]
    predictions: tuple[Prediction, ...]
    warnings: tuple[PreflightWarning, ...]


class AskedServer(Struct, frozen=True):
    """How many drones come into range of a server, and how many request a slot there."""

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
        """The warnings of all drones; equal warnings are one, with the names of their drones."""
        names: dict[PreflightWarning, list[str]] = {}
        for drone in self.drones:
            for warning in drone.warnings:
                names.setdefault(warning, []).append(drone.drone)
        return tuple(
            PreflightWarning(warning.kind, f"{', '.join(of)}: {warning.text}")
            for warning, of in names.items()
        )


Runs = Mapping[str, Run]  # by drone


class _Flight(Struct, frozen=True):
    """What one process does in one go."""

    document: Document
    file: Path
    seed: int
    local_only: bool


def check_fleet(document: Document, file: Path, *, seeds: int, workers: int | None) -> FleetCheck:
    """Flies the drones with every call on them and as configured, with the seeds 1 to `seeds`."""
    document = changed(document)
    config = drone_config(document, file)
    flights = [
        _Flight(document, file, seed, local_only)
        for seed in range(1, seeds + 1)
        for local_only in (True, False)
    ]
    with work("fleets flown in simulation", len(flights)) as done:
        runs = processes.in_order(_fly, flights, workers=workers, done=done)
    flown = {
        case: [run for flight, run in zip(flights, runs, strict=True) if flight.local_only is local_only]
        for case, local_only in ((LOCAL_ONLY, True), (AS_CONFIGURED, False))
    }
    return FleetCheck(
        config=str(file),
        drones=tuple(_forecast(drone, flown) for drone in fleet_of(config)),
        servers=tuple(_asked(server.name, flown[AS_CONFIGURED]) for server in config.servers),
        notices=tuple(file_notices(config)),
    )


def _fly(flight: _Flight) -> Runs:
    config = msgspec.structs.replace(drone_config(flight.document, flight.file), seed=flight.seed)
    return simulate_drones(with_policy(config, LOCAL_ONLY) if flight.local_only else config)


def _forecast(config: DroneConfig, flown: Mapping[str, Sequence[Runs]]) -> DroneForecast:
    specs = load_specs(config.services)
    flown_config, speed_why = with_speed(config, simulate)
    cases = (LOCAL_ONLY,) if config.policy.name == LOCAL_ONLY else (LOCAL_ONLY, AS_CONFIGURED)
    runs = {case: [by_drone[config.name] for by_drone in flown[case]] for case in cases}
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
    found = warnings(flown_config, covered, list(beliefs(config, alone)), predictions)
    return DroneForecast(
        drone=config.name,
        waypoints=len(places),
        order=order_of(config, specs).why,
        speed=check_speed(flown_config, speed_why) or UNSET,
        uncovered=uncovered(len(places), covered),
        predictions=predictions,
        warnings=tuple(found),
    )


def _prediction(config: DroneConfig, case: str, runs: Sequence[Run]) -> Prediction:
    failures = [failure_of(run) for run in runs]
    completed = [
        run.result for run, why in zip(runs, failures, strict=True) if run.result.completed and not why
    ]
    return prediction_of(
        case,
        len(runs),
        time_s=mean_or_none([result.mission_time_s for result in completed]),
        energy_wh=mean_or_none([result.energy.total_wh for result in completed if result.energy]),
        lighter=mean_or_none([result.totals.lighter for result in completed if config.mission.lighter]),
        failures=[why for run, why in zip(runs, failures, strict=True) if why and not run.vanished],
    )


def _asked(server: str, flown: Sequence[Runs]) -> AskedServer:
    met: set[str] = set()
    asking: set[str] = set()
    for runs in flown:
        for name, run in runs.items():
            if any(stay.server == server for stay in run.range_intervals):
                met.add(name)
            if any(isinstance(event, schema.Selected) and event.server == server for event in run.events):
                asking.add(name)
    return AskedServer(server, len(met), len(asking))


def show_fleet_check(plan: CheckInput, *, seeds: int, as_json: bool, workers: int | None) -> bool:
    """Checks the file and prints what was found; returns whether there is nothing to warn of."""
    found = check_fleet(
        plan.document, plan.file, seeds=seeds if plays_a_part(plan.config) else 1, workers=workers
    )
    if as_json:
        share = demanding_share(plan.config)
        of_going = {} if share is None else {"demanding_share": share}
        printed = msgspec.to_builtins(found) | {"warnings": found.warnings} | of_going
        sys.stdout.write(msgspec.json.encode(printed).decode() + "\n")
    else:
        _print(found, plan.config, Console(markup=False))
    return not found.warnings


def _print(found: FleetCheck, config: DroneConfig, console: Console) -> None:
    say(
        f"{found.config} is understood: {counted(len(found.drones), 'drone')}, "
        f"{counted(len(config.services), 'service')}, {counted(len(config.servers), 'server')}",
        console,
    )
    console.print()
    show_table(_forecast_table(found.drones), console)
    if acts := told_acts(config):
        say(acts, console)
    console.print()
    for drone in found.drones:
        if drone.order:
            say(Text(f"order of {drone.drone}'s waypoints: {drone.order}"), console)
        if drone.speed is not UNSET:
            for line in told_speed(drone.speed):
                say(f"{drone.drone}: {line}", console)
    for server in found.servers:
        say(
            f"{server.server}: in range of {server.in_range_of} of {counted(len(found.drones), 'drone')}, "
            f"asked for a slot by {server.asked_by}",
            console,
        )
    print_findings(found.notices, found.warnings, console)


def _forecast_table(drones: tuple[DroneForecast, ...]) -> Table:
    table = Table(box=None, padding=(0, 1))
    table.add_column("drone", overflow="fold")
    for title in ("waypoints", LOCAL_ONLY, AS_CONFIGURED):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("out of range", overflow="fold")
    for drone in drones:
        by_case = {prediction.case: prediction for prediction in drone.predictions}
        table.add_row(
            Text(drone.drone),
            str(drone.waypoints),
            _time(by_case[LOCAL_ONLY]),
            _time(by_case.get(AS_CONFIGURED)),
            spans(drone.uncovered),
        )
    return table


def _time(prediction: Prediction | None) -> str:
    if prediction is None:
        return "-"
    if prediction.mission_time_s is None:
        return "not completed" if prediction.failures else "vanishes"
    return lasting(prediction.mission_time_s, prediction.margin_s)
