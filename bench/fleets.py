"""What simulated fleets cost: `python -m bench.fleets`.

Fleets of several sizes fly the thesis's mission (scenarios/thesis.toml) in light mode over one field. Eight servers
have a slot for each drone and time for all calls. The result is the time on one core, and how the cost of one drone
grows with the number of drones. See docs/science.md.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import fmean, median

import msgspec
from bench.program import command_line, machine

from upwash.config.drone import DroneConfig, FleetDroneConfig, ServerConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.world import TruthConfig
from upwash.lab.run import simulate_drones
from upwash.lab.scenario import with_policy

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "thesis.toml"
PLACES_M = tuple(product((20.0, 70.0, 120.0, 170.0), (60.0, 140.0)))  # of the servers, which cover the field
POLICIES = ("location-aware", "look-ahead")
MOST_S = 60.0  # for the largest fleet
MOST_GROWTH = 1.5  # of the cost of one drone, from the second fleet to the last


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    rounds: int
    drones: Sequence[int]


@dataclass(frozen=True)
class Flown:
    """The processor's time that a fleet's simulation took, all threads together, and its drones' mean mission."""

    took_s: float
    mission_min: float


FULL = Extent(rounds=3, drones=(1, 10, 30, 100))
QUICK = Extent(rounds=1, drones=(1, 2))


def main() -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    extent = QUICK if command_line("fleets", __doc__).parse_args().quick else FULL
    print(machine())
    config = read_drone_config(SCENARIO)
    print("\ndrones  mission min        s  ms/drone")
    for policy in POLICIES:
        measure(with_policy(config, policy), extent)


def measure(config: DroneConfig, extent: Extent) -> None:
    """Prints a line for each fleet, and how the cost of one drone has grown."""
    print(f"- {config.policy.name}")
    found: dict[int, list[Flown]] = {count: [] for count in extent.drones}
    for _, count in product(range(extent.rounds), extent.drones):
        found[count].append(fly(with_drones(config, count)))
    costs_ms = []
    for count, flown in found.items():
        took_s = median(each.took_s for each in flown)
        costs_ms.append(1e3 * took_s / count)
        print(f"{count:6}  {flown[0].mission_min:11.1f}  {took_s:7.2f}  {costs_ms[-1]:8.1f}")
    growth = costs_ms[-1] / costs_ms[1]
    print(f"  {took_s:.1f} s (limit {MOST_S:.0f}: {verdict(took_s, MOST_S)}), ", end="")
    print(f"grown by {growth:.2f} (limit {MOST_GROWTH:.2f}: {verdict(growth, MOST_GROWTH)})")


def with_drones(config: DroneConfig, count: int) -> DroneConfig:
    """A fleet over one field, with eight servers that take all drones."""
    first = config.servers[0]
    servers = tuple(copy_of(first, number, at_m, slots=count) for number, at_m in enumerate(PLACES_M))
    drones = tuple(FleetDroneConfig(name=f"d{number}") for number in range(count))
    return replace(config, mission=replace(config.mission, mode="light"), servers=servers, drones=drones)


def copy_of(server: ServerConfig, number: int, at_m: tuple[float, float], *, slots: int) -> ServerConfig:
    """The server under another name at another place."""
    name = f"c{number}"
    east_m, north_m = at_m
    return replace(
        server, name=name, network=name, east_m=east_m, north_m=north_m, truth=TruthConfig(slots=slots)
    )


def fly(config: DroneConfig) -> Flown:
    """Simulates the fleet."""
    began_s = time.process_time()
    runs = simulate_drones(config)
    took_s = time.process_time() - began_s
    assert all(run.result.completed for run in runs.values())
    return Flown(took_s, fmean(run.result.mission_time_s for run in runs.values()) / 60)


def verdict(value: float, most: float) -> str:
    """Whether a limit was met."""
    return "ok" if value <= most else "MISS"


replace = msgspec.structs.replace

if __name__ == "__main__":
    main()
