"""upwash simulate: simulates one mission, or those of several drones at the same time."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.cli.arguments import (
    CALLS,
    OneOf,
    figures_of,
    figures_with,
    option,
    policy_instead_of,
    reads,
    warn_of_files,
    whole,
    writes,
)
from upwash.config.drone import DroneConfig
from upwash.errors import UpwashError, UsageError
from upwash.eventlog import schema
from upwash.eventlog.kept import lines_of
from upwash.eventlog.results import as_json
from upwash.eventlog.terminal import print_result
from upwash.lab.figures import FigureFiles
from upwash.lab.least_time import Bound
from upwash.lab.scenario import read_scenario
from upwash.lab.simulation import FleetSimulation, Simulation, simulate, simulate_fleet
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.software import software
from upwash.support.spared import require_spared
from upwash.support.tables import show_table
from upwash.support.text import lasting, printable

_PRINTED = ("scenario", "policy", "seed", "mission_time_s", "completed", "calls", "totals", "bound")
_PRINTED_OF_FLEET = ("scenario", "seed", "mean_s", "worst_s", "jain", "saved_s", "bound")


ARGUMENTS = {
    "scenario": reads("the scenario, a TOML file"),
    **policy_instead_of("the scenario's"),
    "--seed N": option("instead of the scenario's", type=whole),
    "shown": OneOf({"--json": "print the result as one JSON object", **CALLS}),
    "--log FILE": writes(
        "where the event log goes, or those of several drones as FILE-NAME (default: nowhere)"
    ),
    "--keep-coverage": "write what was measured of servers without a range to network.coverage_map, as a "
    "flight does",
    "--keep-demands": "write the places of demands to policy.demand_map, as a flight does",
    **figures_with("the map and the call delays"),
}


def run(options: argparse.Namespace) -> None:
    """Simulate and print the results."""
    config = read_scenario(options.scenario, policy=options.policy, seed=options.seed)
    warn_of_files(config)
    if config.drones:
        _run_fleet(options, config)
    else:
        _run_one(options)


def _run_one(options: argparse.Namespace) -> None:
    figures = figures_of(options)
    with work("simulating"):
        simulation = simulate(
            options.scenario,
            policy=options.policy,
            seed=options.seed,
            keep_coverage=options.keep_coverage,
            keep_demands=options.keep_demands,
        )
    if options.json:
        _print_json(_as_object(simulation) | _origin(simulation))
    else:
        _print_simulation(simulation, calls=options.calls)
    if options.log is not None:
        with work("writing the log"):
            _write_log(options.log, simulation, options.scenario, of=simulation)
    if figures is not None:
        _draw(simulation, options.scenario, figures)
    if simulation.failure:
        raise UpwashError(f"the mission was not completed: {simulation.failure}")


def _run_fleet(options: argparse.Namespace, config: DroneConfig) -> None:
    if options.keep_coverage:
        raise UsageError("--keep-coverage keeps one drone's map, and this scenario has several drones")
    if options.keep_demands:
        raise UsageError("--keep-demands keeps one drone's map, and this scenario has several drones")
    if options.calls:
        raise UsageError(
            "--calls prints those of one mission, and this scenario has several drones: --log keeps their logs, "
            "and upwash explain says why each call ran where it ran"
        )
    if options.figures is not None:
        raise UsageError(
            "--figures draws one mission, and this scenario has several drones: --log keeps their logs, "
            "and upwash report makes a page of them"
        )
    logs = {} if options.log is None else _fleet_logs(options.log, config)
    with work("simulating"):
        fleet = simulate_fleet(options.scenario, policy=options.policy, seed=options.seed)
    if options.json:
        drones = {name: _as_object(simulation) for name, simulation in fleet.drones.items()}
        shown = {name: getattr(fleet, name) for name in _PRINTED_OF_FLEET}
        _print_json({"drones": drones} | shown | _origin(fleet))
    else:
        _print_fleet(fleet)
    if options.log is not None:
        for name, simulation in fleet.drones.items():
            _write_log(logs[name], simulation, options.scenario, of=fleet)
    for name, failure in fleet.failures.items():
        raise UpwashError(f"{name} did not complete its mission: {failure}")


def _fleet_logs(log: Path, config: DroneConfig) -> dict[str, Path]:
    """The log of each drone; raises UsageError where one is an input."""
    logs = {drone.name: log.with_name(f"{log.stem}-{drone.name}{log.suffix}") for drone in config.drones}
    for each in logs.values():
        require_spared(each)
    return logs


def _draw(simulation: Simulation, scenario: Path, figures: FigureFiles) -> None:
    from upwash.lab.figures.calls import draw_call_delays  # these need matplotlib
    from upwash.lab.figures.coverage import draw_coverage

    draw_coverage(read_scenario(scenario, policy=simulation.policy), figures.files("map"))
    reference = simulate(scenario, policy="local-only", seed=simulation.seed)
    draw_call_delays(simulation.events, reference=reference.events, files=figures.files("call_delay"))


def _write_log(
    file: Path, simulation: Simulation, scenario: Path, *, of: Simulation | FleetSimulation
) -> None:
    """Write the log that a flight would have left, after an event that says what was simulated by what."""
    named = schema.Simulated(
        t=0.0,
        scenario=str(scenario.resolve()),
        seed=of.seed,
        version=schema.VERSION,
        upwash=software().version,
        commit=software().commit,
        configuration=msgspec.json.encode(of.configuration).decode(),
    )
    write_file(file, itertools.chain(lines_of([named]), lines_of(simulation.events)))


def _origin(result: Simulation | FleetSimulation) -> dict[str, Any]:
    """What the result was made of, and by what."""
    return {"upwash": software()._asdict(), "configuration": result.configuration}


def _print_json(printed: dict[str, Any]) -> None:
    sys.stdout.write(msgspec.json.encode(as_json(printed)).decode() + "\n")


def _print_simulation(simulation: Simulation, *, calls: bool) -> None:
    """Print the result of one mission, how far it is from the bound, and rows of its calls."""
    console = Console(markup=False)
    servers = any(isinstance(event, schema.Planned) and event.has_servers for event in simulation.events)
    beside = "" if simulation.bound is None else _beside(simulation, simulation.bound)
    print_result(
        simulation, simulation.events, console, paced=False, servers=servers, beside=beside, calls=calls
    )


def _as_object(simulation: Simulation) -> dict[str, Any]:
    printed = {name: getattr(simulation, name) for name in _PRINTED}
    if simulation.energy is not None:
        printed["energy"] = simulation.energy
    if simulation.failure:
        printed["failure"] = simulation.failure
    if simulation.offloading_failed:
        printed["offloading_failed"] = simulation.offloading_failed
    if simulation.vanished:
        printed["vanished"] = True
    return printed


def _beside(simulation: Simulation, bound: Bound) -> str:
    time_s = simulation.mission_time_s
    least, with_joins = _beyond(bound.free_s, time_s), _beyond(bound.with_joins_s, time_s)
    minimum = f"theoretical minimum {least}, with every server ready at once"
    if simulation.totals.went_on:
        return f"{minimum} and known beforehand which answers demand something"
    joins = "the time that joining networks takes"
    return f"{minimum}, and with {joins}" if with_joins == least else f"{minimum}; {with_joins}, with {joins}"


def _print_fleet(fleet: FleetSimulation) -> None:
    """Print a row for each drone, and the results of all together."""
    console = Console(markup=False)
    table = Table(box=None, padding=(0, 2))
    for title in ("drone", "policy"):
        table.add_column(title, overflow="fold")
    for title in ("mission time", "saved", "on servers"):
        table.add_column(title, justify="right", no_wrap=True)
    for name, drone in fleet.drones.items():
        time = (
            lasting(drone.mission_time_s) if drone.completed else "vanished" if drone.vanished else "failed"
        )
        saved = lasting(fleet.saved_s[name]) if name in fleet.saved_s else "-"
        remote = f"{sum(drone.totals.remote.values())} of {drone.totals.calls}"
        table.add_row(*map(Text, (name, drone.policy, time, saved, remote)))
    show_table(table, console)
    for line in _together(fleet):
        say(line, console)
    for name, drone in fleet.drones.items():
        if drone.offloading_failed:
            why = f"{name}: every call ran on the drone after a defect: {printable(drone.offloading_failed)}"
            say(Text(why, style="yellow"), console)


def _together(fleet: FleetSimulation) -> Iterator[str]:
    if fleet.mean_s is None or fleet.worst_s is None:
        yield "no mission was completed"
        return
    yield f"mission time: mean {lasting(fleet.mean_s)}, worst {lasting(fleet.worst_s)}"
    if fleet.jain is not None:
        yield f"fairness {fleet.jain:.3f} (Jain's index of what each saved: 1 where all saved the same)"
    left_out = [name for name, drone in fleet.drones.items() if not drone.completed]
    if left_out:
        yield f"not counted, as they did not complete their missions: {', '.join(left_out)}"
    if fleet.bound is not None:
        free, shared = (
            _beyond(least_s, fleet.mean_s) for least_s in (fleet.bound.free_s, fleet.bound.shared_s)
        )
        yield (
            f"theoretical minimum of the mean {free}, with every server ready at once and for each drone alone; "
            f"{shared}, with what the servers can compute at a time"
        )


def _beyond(least_s: float, time_s: float) -> str:
    """The least time, and by how much the time is longer."""
    beyond = round(100 * (time_s / least_s - 1), 1) + 0.0  # no -0.0
    return f"{lasting(least_s)} ({beyond:+.1f} %)"
