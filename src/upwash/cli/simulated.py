"""What a simulation prints and writes: one mission's, and those of several drones."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.eventlog import schema
from upwash.eventlog.kept import lines_of
from upwash.eventlog.results import as_json
from upwash.eventlog.terminal import print_result
from upwash.support.output_files import write_file
from upwash.support.sentences import say

if TYPE_CHECKING:
    from upwash import Bound, Event, FleetBound, FleetSimulation, Simulation

_PRINTED = (
    "scenario",
    "policy",
    "seed",
    "mission_time_s",
    "completed",
    "calls",
    "totals",
    "bound",
)
_PRINTED_OF_FLEET = ("scenario", "seed", "mean_s", "worst_s", "jain", "saved_s", "bound")


def print_json(simulation: Simulation) -> None:
    """One mission as an object on a line."""
    _print_line(_as_object(simulation))


def print_fleet_json(fleet: FleetSimulation) -> None:
    """Several missions as an object on a line, each under its drone's name."""
    drones = {name: _as_object(each) for name, each in fleet.drones.items()}
    _print_line({"drones": drones} | {name: getattr(fleet, name) for name in _PRINTED_OF_FLEET})


def print_simulation(simulation: Simulation) -> None:
    """One mission for a person: its calls, and how far it is from the bound."""
    console = Console(markup=False)
    servers = any(isinstance(event, schema.Planned) and event.has_servers for event in simulation.events)
    print_result(simulation, console, paced=False, servers=servers)
    if simulation.bound is not None:
        say(_beside(simulation, simulation.bound), console)


def print_fleet(fleet: FleetSimulation) -> None:
    """Several missions for a person: a row for each drone, and what they came to together."""
    console = Console(markup=False)
    console.print(_drone_table(fleet))
    for line in _together(fleet):
        say(line, console)


def write_log(file: Path, events: Sequence[Event], scenario: Path, *, seed: int) -> None:
    """The events as the flying drone would have written them, behind one that names the scenario."""
    named = schema.Simulated(t=0.0, scenario=str(scenario.resolve()), seed=seed, version=schema.VERSION)
    write_file(file, itertools.chain(lines_of([named]), lines_of(events)))


def _print_line(printed: dict[str, Any]) -> None:
    sys.stdout.write(msgspec.json.encode(as_json(printed)).decode() + "\n")


def _as_object(simulation: Simulation) -> dict[str, Any]:
    printed = {name: getattr(simulation, name) for name in _PRINTED}
    if simulation.energy is not None:
        printed["energy"] = simulation.energy
    if simulation.failure:
        printed["failure"] = simulation.failure
    if simulation.vanished:
        printed["vanished"] = True
    return printed


def _beside(simulation: Simulation, bound: Bound) -> str:
    time_s = simulation.mission_time_s
    minimum = f"theoretical minimum {_beyond(bound.free_s, time_s)}, with every server ready at once"
    if simulation.totals.went_on:
        return f"{minimum} and known beforehand which answers demand something"
    return f"{minimum}; {_beyond(bound.with_joins_s, time_s)}, with the time that joining networks takes"


def _drone_table(fleet: FleetSimulation) -> Table:
    table = Table(box=None, padding=(0, 2))
    for title in ("drone", "policy"):
        table.add_column(title, overflow="fold", min_width=len("location-aware"))
    for title in ("mission time", "saved", "on servers"):
        table.add_column(title, justify="right", no_wrap=True)
    for name, each in fleet.drones.items():
        time = f"{each.mission_time_s:.1f} s" if each.completed else "vanished" if each.vanished else "failed"
        saved = f"{fleet.saved_s[name]:.1f} s" if name in fleet.saved_s else "-"
        remote = f"{sum(each.totals.remote.values())} of {each.totals.calls}"
        table.add_row(*map(Text, (name, each.policy, time, saved, remote)))
    return table


def _together(fleet: FleetSimulation) -> Iterator[str]:
    if fleet.mean_s is None or fleet.worst_s is None:
        yield "no mission was completed"
        return
    yield f"mission time: mean {fleet.mean_s:.1f} s, worst {fleet.worst_s:.1f} s"
    if fleet.jain is not None:
        yield f"fairness {fleet.jain:.3f} (Jain's index of what each saved: 1 where all saved the same)"
    left_out = [name for name, each in fleet.drones.items() if not each.completed]
    if left_out:
        yield f"not counted, as they did not complete their missions: {', '.join(left_out)}"
    if fleet.bound is not None:
        yield _beside_all(fleet.mean_s, fleet.bound)


def _beside_all(mean_s: float, bound: FleetBound) -> str:
    return (
        f"theoretical minimum of the mean {_beyond(bound.free_s, mean_s)}, with every server ready at once and for "
        f"each drone alone; {_beyond(bound.shared_s, mean_s)}, with what the servers can compute at a time"
    )


def _beyond(least_s: float, time_s: float) -> str:
    """The least time, and by how much the time is longer."""
    beyond = round(100 * (time_s / least_s - 1), 1) + 0.0  # no -0.0
    return f"{least_s:.1f} s ({beyond:+.1f} %)"
