"""Flies the demonstration with several drones: each a program of its own, past the same two daemons."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from upwash.cli.demonstration.configuration import filled_in, fleet_of, start_of
from upwash.cli.demonstration.daemons import ready_daemons
from upwash.cli.demonstration.following import followed
from upwash.cli.demonstration.outcome import Outcome, outcome_of, print_outcomes
from upwash.cli.live import shown_live
from upwash.config import DroneConfig, waypoints
from upwash.emulation.programs import write_drone_file
from upwash.errors import MissionStopped
from upwash.eventlog.fleet import FleetProgress
from upwash.launch.flight_program import INTERRUPTED, FlightProgram
from upwash.launch.processes import ends_with_us, ready_vehicle
from upwash.real.host.signals import outliving_the_terminal, stopping_politely
from upwash.real.trust.authority import make_keys

_DEPARTURE_S = 3.0  # after the one before


def fly_fleet(
    folder: Path,
    config: DroneConfig,
    drones: int,
    *,
    runtime: str = "",
    live_port: int | None = None,
) -> bool:
    """Flies it with so many drones and everything below `folder`; returns whether every flight was completed.

    Whatever it started is gone when it returns or raises. The other arguments are those of `fly_demonstration`.
    """
    console = Console(markup=False)
    names = [server.name for server in config.servers]
    fleet = fleet_of(config, drones)
    logs = {drone.name: folder / f"{drone.name}.jsonl" for drone in fleet}
    make_keys(folder / "keys", servers=[[name] for name in names], drones=list(logs))
    with contextlib.ExitStack() as processes:
        vehicles = {
            drone.name: processes.enter_context(
                ready_vehicle(f"{drone.name}-vehicle", folder, drone, start=start_of(drone))
            )
            for drone in fleet
        }
        servers = processes.enter_context(ready_daemons(names, folder, runtime=runtime))
        for drone in fleet:
            here = filled_in(drone, folder.absolute(), vehicle=vehicles[drone.name], servers=servers)
            write_drone_file(_file(drone, folder), here)
        for log in logs.values():
            log.touch()  # a flight that has yet to begin
        console.print(
            f"{len(fleet)} vehicles; the servers are at {', '.join(servers.values())}", soft_wrap=True
        )
        processes.enter_context(shown_live(list(logs.values()), live_port))
        progress = processes.enter_context(FleetProgress(list(logs), len(waypoints(config.mission)), console))
        exit_codes = asyncio.run(_fly(fleet, logs, folder, progress))
    outcomes = {name: outcome_of(log, exit_codes[name]) for name, log in logs.items()}
    print_outcomes(outcomes, names, console)
    console.print(f"event logs: {', '.join(map(str, logs.values()))}", soft_wrap=True)
    return _completed(outcomes)


def _file(drone: DroneConfig, folder: Path) -> Path:
    return folder / f"{drone.name}.toml"


def _completed(outcomes: Mapping[str, Outcome]) -> bool:
    if any(outcome.exit_code == INTERRUPTED for outcome in outcomes.values()):
        raise MissionStopped("Ctrl-C")
    return all(outcome.exit_code == 0 for outcome in outcomes.values())


async def _fly(
    fleet: Sequence[DroneConfig], logs: Mapping[str, Path], folder: Path, progress: FleetProgress
) -> dict[str, int]:
    """Each flight's exit code, once all are over; Ctrl-C has all of them end their missions and land."""
    programs = {
        drone.name: FlightProgram(
            _file(drone, folder),
            logs[drone.name],
            say=functools.partial(progress.say, drone.name),
            options=["--quiet"],
            through=ends_with_us(),
        )
        for drone in fleet
    }

    def stop(_: str) -> None:
        for program in programs.values():
            program.stop()

    with stopping_politely(stop), outliving_the_terminal():
        async with followed(logs, progress.follow), asyncio.TaskGroup() as group:
            flights = {
                drone: group.create_task(program.run(after_s=number * _DEPARTURE_S))
                for number, (drone, program) in enumerate(programs.items())
            }
    return {drone: flight.result() for drone, flight in flights.items()}
