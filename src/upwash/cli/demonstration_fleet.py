"""The demonstration with several drones: each a program of its own, past the same two daemons."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from msgspec.structs import replace
from rich import box
from rich.console import Console
from rich.table import Table

from upwash.cli.arguments import Live
from upwash.cli.demonstration import filled_in, ready_daemons, score_photos
from upwash.cli.fly import shown_live
from upwash.config.drone import DroneConfig, MissionConfig
from upwash.config.places import waypoints
from upwash.core.geo import Position
from upwash.emulation.programs import write_config
from upwash.errors import MissionStopped, UsageError
from upwash.eventlog.fleet import FleetProgress
from upwash.eventlog.log import EventLog, LineReader
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import Event
from upwash.launch.processes import INTERRUPTED, FlightProgram, ends_with_us, ready_vehicle
from upwash.real.host.signals import outliving_the_terminal, stopping_politely
from upwash.real.trust.authority import make_keys
from upwash.support.background import beside
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, lasting
from upwash.view.tail import Tail

_DEPARTURE_S = 3.0  # after the drone before
_LANE_M = 5.0
_FIELD_M = (
    10.0  # between the outermost lanes: further apart, the servers cover fewer waypoints of some drones
)
_LOOK_S = 0.1
_log = logging.getLogger("upwash.demonstration")


def fly_fleet(folder: Path, config: DroneConfig, drones: int, *, runtime: str, live: Live | None) -> bool:
    """Fly with that number of drones, as `fly_demonstration`; true where every flight was completed."""
    console = Console(markup=False)
    names = [server.name for server in config.servers]
    fleet = fleet_of(config, drones)
    files = {drone.name: folder / f"{drone.name}.toml" for drone in fleet}
    logs = {name: file.with_suffix(".jsonl") for name, file in files.items()}
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
            write_config(files[drone.name], here)
            logs[drone.name].touch()  # the page shows a flight that has yet to begin
        console.print(
            f"{counted(len(fleet), 'vehicle')}; the servers are at {', '.join(servers.values())}",
            soft_wrap=True,
        )
        processes.enter_context(shown_live(list(logs.values()), live))
        progress = processes.enter_context(
            FleetProgress(list(logs), names, len(waypoints(config.mission)), console)
        )
        exit_codes = asyncio.run(_fly(files, logs, progress))
    results = {name: DemonstratedFlight.of(log, exit_codes[name]) for name, log in logs.items()}
    print_results(results, names, console)
    flown = [log for name, log in logs.items() if results[name].result is not None]
    say(score_photos(flown).in_words(), console)
    console.print(f"event logs: {', '.join(map(str, logs.values()))}", soft_wrap=True)
    if INTERRUPTED in exit_codes.values():
        raise MissionStopped("Ctrl-C")
    return not any(exit_codes.values())


def fleet_of(config: DroneConfig, drones: int) -> list[DroneConfig]:
    """That number of drones instead of one, each with a name and a lane of its own.

    The lanes lie one within the other, so that no way crosses another; the first drone flies the outermost one.
    """
    spacing_m = min(_LANE_M, _FIELD_M / max(1, drones - 1))
    wider_m = [spacing_m * (drones - 1 - 2 * number) / 2 for number in range(drones)]
    return [
        replace(
            config,
            name=f"{config.name}-{number + 1}",
            mission=_on_lane(config.mission, wider_m=wider, longer_m=wider - wider_m[-1]),
        )
        for number, wider in enumerate(wider_m)
    ]


def _on_lane(mission: MissionConfig, *, wider_m: float, longer_m: float) -> MissionConfig:
    """Move the outermost waypoints further out: `wider_m` to north and south, `longer_m` to east and west."""
    places = mission.waypoints_m or ()
    easts_m, norths_m = zip(*places, strict=True)
    moved = tuple(
        (_further_out(east_m, easts_m, longer_m), _further_out(north_m, norths_m, wider_m))
        for east_m, north_m in places
    )
    return replace(mission, waypoints_m=moved)


def _further_out(place_m: float, all_m: Sequence[float], by_m: float) -> float:
    if place_m == min(all_m):
        return place_m - by_m
    return place_m + by_m if place_m == max(all_m) else place_m


def start_of(config: DroneConfig) -> Position:
    """Where the drone stands at first: below its first waypoint, where no other drone stands."""
    first = waypoints(config.mission)[0].position
    return Position(first.east_m, first.north_m)


async def _fly(
    files: Mapping[str, Path], logs: Mapping[str, Path], progress: FleetProgress
) -> dict[str, int]:
    """Each flight's exit code, once all are over; Ctrl-C has all of them end their missions and land."""
    programs = {
        name: FlightProgram(
            file,
            logs[name],
            say=functools.partial(progress.say, name),
            options=["--quiet"],
            through=ends_with_us(),
        )
        for name, file in files.items()
    }

    def stop(_: str) -> None:
        for program in programs.values():
            program.stop()

    with stopping_politely(stop), outliving_the_terminal():
        async with followed(logs, progress.follow), asyncio.TaskGroup() as group:
            flights = {
                name: group.create_task(program.run(after_s=number * _DEPARTURE_S))
                for number, (name, program) in enumerate(programs.items())
            }
    return {name: flight.result() for name, flight in flights.items()}


@contextlib.asynccontextmanager
async def followed(logs: Mapping[str, Path], follow: Callable[[str, Event], None]) -> AsyncIterator[None]:
    """Pass each event of each drone's log to `follow`, until the end of the block and of the logs.

    The logs must exist. A log that cannot be read is followed no further.
    """
    with contextlib.ExitStack() as stack:
        growing = {drone: _GrowingLog(log, stack) for drone, log in logs.items()}

        def look() -> None:
            for drone, log in growing.items():
                for event in log.news():
                    follow(drone, event)

        async def watch() -> None:
            while True:
                look()
                await asyncio.sleep(_LOOK_S)

        try:
            async with beside(watch(), name="the reader of the flights' logs"):
                yield
        finally:
            look()


class _GrowingLog:
    """A log that a flight writes."""

    def __init__(self, log: Path, stack: contextlib.ExitStack) -> None:
        self._tail = stack.enter_context(contextlib.closing(Tail(log)))
        self._lines = LineReader(log)
        self._readable = True

    def news(self) -> Iterator[Event]:
        """The events since the last call."""
        try:
            while self._readable and (lines := self._tail.read()) is not None:
                yield from self._lines.take_all(lines)
        except UsageError as error:
            self._readable = False
            _log.warning("%s", error)


@dataclass(frozen=True, slots=True)
class DemonstratedFlight:
    """How one drone's program ended, and the result of its flight; None where none began."""

    exit_code: int
    result: RunResult | None

    @classmethod
    def of(cls, log: Path, exit_code: int) -> DemonstratedFlight:
        """The flight of that log, whose program has ended with that code."""
        try:
            return cls(exit_code, read_result(EventLog(log)))
        except UsageError:  # the log is empty: the program ended before there was a flight
            return cls(exit_code, None)

    @property
    def in_words(self) -> str:
        """How the flight ended."""
        if self.exit_code == INTERRUPTED:
            return "ended early" if self.result else "did not begin"
        if self.exit_code:
            return f"exit code {self.exit_code}"
        return "completed"


def print_results(
    flights: Mapping[str, DemonstratedFlight], servers: Sequence[str], console: Console
) -> None:
    """Print a row for each drone, and the mean and the worst of the completed flights."""
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("drone", "flight"):
        table.add_column(head, no_wrap=True)
    places = ("on the\ndrone", *(f"on\n{server}" for server in servers))
    for head in ("time", "saved", *places, "waits", "wasted"):
        table.add_column(head, justify="right", no_wrap=True)
    for drone, flight in flights.items():
        table.add_row(drone, flight.in_words, *_cells(flight.result, servers))
    show_table(table, console)
    say(summary([flight.result for flight in flights.values()]), console)


def _cells(result: RunResult | None, servers: Sequence[str]) -> list[str]:
    if result is None:
        return []
    saved_s, totals = result.saved_s(), result.totals
    numbers = (totals.local, *(totals.remote.get(server, 0) for server in servers))
    return [
        lasting(result.mission_time_s),
        "" if saved_s is None else lasting(saved_s),
        *map(str, (*numbers, totals.waits, totals.waits_failed)),
    ]


def summary(results: Sequence[RunResult | None]) -> str:
    """The mean and the worst of the completed flights, in a sentence."""
    completed = [result for result in results if result is not None and result.completed]
    if not completed:
        return "no flight was completed"
    times_s = [result.mission_time_s for result in completed]
    all_saved_s = [saved_s for result in completed if (saved_s := result.saved_s()) is not None]
    saved = (
        f"; saved: mean {lasting(mean(all_saved_s))}, least {lasting(min(all_saved_s))}"
        if all_saved_s
        else ""
    )
    return (
        f"{len(completed)} of {counted(len(results), 'flight')} completed; "
        f"mission time: mean {lasting(mean(times_s))}, worst {lasting(max(times_s))}{saved}"
    )
