"""Mission times of fleets that share servers, by the servers' rule for slots: `python -m bench.sharing --keep`.

Fleets of 1 to 16 drones fly in three layouts, and three scenarios as they are. Each server has one slot, first come;
or one slot, in turns; or as many as it measures to be right, in turns; or one for every drone. The result is kept
in bench/results/sharing.json, and `python -m bench.promises` brings it into docs/fleets.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import msgspec
from bench.program import command_line
from bench.results import FOLDER, leave

from upwash.config.drone import DroneConfig, FleetDroneConfig, ServerConfig
from upwash.config.drone_file import fleet_of, read_drone_config
from upwash.lab.bounds import bounds_of
from upwash.lab.outcome import fleet_outcome
from upwash.lab.processes import in_processes
from upwash.lab.run import simulate_drones

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
FLEETS, QUICK_FLEETS = (1, 2, 4, 8, 16), (1,)
AS_THEY_ARE = ("fleet-overloaded-server", "fleet-mixed", "fleet-vanishing")
FIELD_M, STEP_M, ROUTE_STEPS = 220.0, 20.0, 40

S = TypeVar("S", bound=msgspec.Struct)


class Way(NamedTuple):
    """How a server gives its slots; without a number, one for every drone."""

    name: str
    slots: int | Literal["auto"] | None
    turn_s: float


WAYS = (
    Way("first come, 1 slot", 1, math.inf),
    Way("turns, 1 slot", 1, 30.0),
    Way("turns, auto", "auto", 30.0),
    Way("a slot for all", None, math.inf),
)


class Shared(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one fleet: minutes, and the evenness of the savings.

    `least_min` is the least possible mean, with `slots` at servers that give as many as they can.
    """

    layout: str
    drones: int
    way: str
    mean_min: float
    worst_min: float
    jain: float
    least_min: float


def same_field(count: int) -> DroneConfig:
    """All drones fly the thesis's field, at the same time, past its two servers."""
    return replaced(thesis(), drones=named(count))


def adjacent_fields(count: int) -> DroneConfig:
    """Four of the thesis's fields in a row, with a server in the middle of each that reaches into the next ones."""
    config = thesis()
    servers = tuple(moved(config.servers[0], number, FIELD_M * number + 100.0, 100.0) for number in range(4))
    drones = (
        replaced(drone, waypoints_m=field(FIELD_M * (number % 4)))
        for number, drone in enumerate(named(count))
    )
    return replaced(config, servers=servers, drones=tuple(drones))


def crossing_routes(count: int) -> DroneConfig:
    """Straight routes through one place, each in its own direction, and four servers about that place."""
    config = thesis()
    places = ((60.0, 0.0), (0.0, 60.0), (-60.0, 0.0), (0.0, -60.0))
    servers = tuple(moved(config.servers[0], number, *place) for number, place in enumerate(places))
    drones = (
        replaced(drone, waypoints_m=route(math.tau * number / max(FLEETS)))
        for number, drone in enumerate(named(count))
    )
    return replaced(config, servers=servers, drones=tuple(drones))


LAYOUTS: dict[str, Callable[[int], DroneConfig]] = {
    "same field, 2 servers": same_field,
    "adjacent fields, 4 servers": adjacent_fields,
    "crossing routes, 4 servers": crossing_routes,
}


def thesis() -> DroneConfig:
    """The thesis's heavy mission."""
    return read_drone_config(SCENARIOS / "thesis.toml")


def named(count: int) -> tuple[FleetDroneConfig, ...]:
    """So many drones."""
    return tuple(FleetDroneConfig(name=f"d{number}") for number in range(1, count + 1))


def moved(server: ServerConfig, number: int, east_m: float, north_m: float) -> ServerConfig:
    """The server under another name at another place."""
    name = f"s{number + 1}"
    return replaced(server, name=name, network=name, east_m=east_m, north_m=north_m)


def field(east_m: float) -> tuple[tuple[float, float], ...]:
    """The thesis's grid, shifted to the east, row by row, there and back."""
    columns = [east_m + STEP_M * column for column in range(11)]
    return tuple((east, STEP_M * row) for row in range(11) for east in columns[:: 1 if row % 2 == 0 else -1])


def route(angle: float) -> tuple[tuple[float, float], ...]:
    """Waypoints through the origin in that direction."""
    ways_m = [STEP_M * (step - ROUTE_STEPS / 2) for step in range(ROUTE_STEPS + 1)]
    return tuple((round(way * math.cos(angle), 3), round(way * math.sin(angle), 3)) for way in ways_m)


def replaced(struct: S, **changes: object) -> S:
    """The same with other values."""
    return msgspec.structs.replace(struct, **changes)


class Flight(NamedTuple):
    """A fleet to fly: its layout or its scenario, the number of drones, and the servers' rule for slots."""

    layout: str
    drones: int
    way: Way


def flights(*, quick: bool) -> Iterator[Flight]:
    """All that are flown, in the order of the tables."""
    for layout in LAYOUTS:
        for count in QUICK_FLEETS if quick else FLEETS:
            for way in WAYS:
                yield Flight(layout, count, way)
    for name in () if quick else AS_THEY_ARE:
        for way in WAYS:
            yield Flight(name, len(scenario(name).drones), way)


def scenario(name: str) -> DroneConfig:
    """The scenario of that name, unchanged."""
    return read_drone_config(SCENARIOS / f"{name}.toml")


def config_of(flight: Flight) -> DroneConfig:
    """The fleet's scenario."""
    make = LAYOUTS.get(flight.layout)
    config = make(flight.drones) if make else scenario(flight.layout)
    slots = flight.drones if flight.way.slots is None else flight.way.slots
    servers = tuple(
        replaced(server, truth=replaced(server.truth, slots=slots, turn_s=flight.way.turn_s))
        for server in config.servers
    )
    return replaced(config, servers=servers)


def fly(flight: Flight) -> Shared:
    """Simulates the fleet."""
    config = config_of(flight)
    runs = simulate_drones(config)
    outcome = fleet_outcome(runs, config)
    _, bound = bounds_of(list(runs.values()), fleet_of(config))
    assert outcome.mean_s is not None and outcome.worst_s is not None and outcome.jain is not None
    return Shared(
        layout=flight.layout,
        drones=flight.drones,
        way=flight.way.name,
        mean_min=outcome.mean_s / 60,
        worst_min=outcome.worst_s / 60,
        jain=outcome.jain,
        least_min=bound.shared_s / 60 if bound else math.nan,
    )


def table(shared: Iterable[Shared], layout: str) -> Iterator[tuple[str, ...]]:
    """One layout's rows: drones, and of each way mean / worst / Jain's index; at last the least mean."""
    by_count: dict[int, list[Shared]] = {}
    for each in shared:
        if each.layout == layout:
            by_count.setdefault(each.drones, []).append(each)
    for count, ways in by_count.items():
        cells = (f"{way.mean_min:.1f} / {way.worst_min:.1f} / {way.jain:.2f}" for way in ways)
        yield str(count), *cells, f"{max(way.least_min for way in ways):.1f}"


HEAD = ("drones", *(way.name for way in WAYS), "bound")


def main() -> None:
    """Flies all of them and prints the tables."""
    parser = command_line("sharing", __doc__)
    parser.add_argument("--keep", action="store_true", help="keep what comes out in bench/results")
    options = parser.parse_args()
    wanted = list(flights(quick=options.quick))
    found: dict[Flight, Shared] = {}
    with in_processes(_fly_one, wanted) as results:
        for number, (flight, came_to) in enumerate(results, start=1):
            found[flight] = came_to
            print(f"{number} of {len(wanted)}", file=sys.stderr)
    shared = [found[flight] for flight in wanted]
    for layout in dict.fromkeys(each.layout for each in shared):
        print(f"\n{layout}: minutes, mean / worst / Jain's index")
        for row in (HEAD, *table(shared, layout)):
            print("  ".join(f"{cell:>22}" for cell in row))
    if options.keep:
        leave(FOLDER / "sharing.json", command="python -m bench.sharing --keep", figures=shared)


def _fly_one(flight: Flight) -> tuple[Flight, Shared]:
    return flight, fly(flight)


if __name__ == "__main__":
    main()
