"""What a simulated mission costs: `python -m bench.simulate`.

One alone, many in a campaign, and how it grows with servers and waypoints. The mission is the thesis's in heavy mode
with offloading (scenarios/thesis.toml). `--against DIR` flies it by another checkout's code too, in turns, and prints
the ratio. See docs/science.md.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import msgspec
from bench.program import command_line, machine

from upwash.config.drone import DroneConfig, GridConfig, ServerConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.places import server_areas, waypoints
from upwash.lab.campaigns.campaign import in_processes, run_campaign
from upwash.lab.campaigns.file import CampaignFile
from upwash.lab.campaigns.sweep import read_sweep
from upwash.lab.run import simulate

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "thesis.toml"
CAMPAIGN_WORKERS = 2
LEAST_REAL_TIME = 40_000
LEAST_MISSIONS_PER_MINUTE = 2_000
MOST_GROWTH = 1.2  # of the cost per waypoint and server in range, from the smallest to the largest
MOST_GROWTH_IN_LINE = {100: 1.2, 1000: 2.0}  # of the cost per waypoint, by servers with few in range


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    warm_up: int
    rounds: int
    seeds: int  # of the campaign
    growth_rounds: int
    sides: Sequence[int]  # of the grids
    servers: Sequence[int]
    turns: int  # of each checkout


FULL = Extent(
    warm_up=3,
    rounds=21,
    seeds=300,
    growth_rounds=3,
    sides=(11, 32, 100),
    servers=(1, 3, 10, 32, 100, 1000),
    turns=20,
)
QUICK = Extent(warm_up=0, rounds=1, seeds=2, growth_rounds=1, sides=(2, 3), servers=(1, 2), turns=1)
MISSIONS_OF_A_TURN = 5
FLIES = """
import sys, time
from pathlib import Path
from upwash.config.drone_file import read_drone_config
from upwash.lab.run import simulate
config, missions = read_drone_config(Path(sys.argv[1])), int(sys.argv[2])
simulate(config)
print("ready", flush=True)
for _ in sys.stdin:
    began = time.perf_counter(), time.process_time()
    for _ in range(missions):
        simulate(config)
    ended = time.perf_counter(), time.process_time()
    print(*(1e3 * (now - then) / missions for then, now in zip(began, ended)), flush=True)
"""


def main() -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    parser = command_line("simulate", __doc__)
    parser.add_argument("--against", type=Path, metavar="DIR", help="only compare with this checkout's code")
    options = parser.parse_args()
    extent = QUICK if options.quick else FULL
    print(machine())
    if options.against is not None:
        compare(options.against.resolve(), extent)
        return
    config = read_drone_config(SCENARIO)
    measure_speed(config, extent)
    measure_campaign(extent)
    measure_growth(config, extent)


def measure_speed(config: DroneConfig, extent: Extent) -> None:
    """One mission alone, against the time that it would take in the air."""
    mission_s = simulate(config).result.mission_time_s
    took_s = seconds(config, rounds=extent.rounds, warm_up=extent.warm_up)
    print(
        f"\none mission of {mission_s / 60:.1f} min: median {1e3 * median(took_s):.1f} ms of {extent.rounds}",
        end="",
    )
    print(f" (from {1e3 * min(took_s):.1f} to {1e3 * max(took_s):.1f})")
    print(verdict("times real time", mission_s / median(took_s), LEAST_REAL_TIME))


def compare(other: Path, extent: Extent) -> None:
    """The mission by this checkout's code and by the other's, in turns: wall and processor time, and their ratios."""
    with contextlib.ExitStack() as stack:
        programs = [stack.enter_context(flying(checkout)) for checkout in (other, SCENARIO.parent.parent)]
        found = [[turn(program) for program in programs] for _ in range(extent.turns)]
    for number, what in enumerate(("wall", "processor")):
        before, now = (median(each[which][number] for each in found) for which in (0, 1))
        ratio = median(each[1][number] / each[0][number] for each in found)
        print(f"{what}: median {before:.1f} ms there, {now:.1f} ms here; ratio within a turn {ratio:.3f}")


@contextlib.contextmanager
def flying(checkout: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that flies the mission some times by that checkout's code whenever it is sent a line."""
    command = [sys.executable, "-c", FLIES, str(SCENARIO), str(MISSIONS_OF_A_TURN)]
    environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        yield program


def turn(program: subprocess.Popen[str]) -> tuple[float, float]:
    """Milliseconds of wall and of processor time that a mission takes it now."""
    assert program.stdin is not None
    assert program.stdout is not None
    program.stdin.write("\n")
    program.stdin.flush()
    wall_ms, processor_ms = map(float, program.stdout.readline().split())
    return wall_ms, processor_ms


def measure_campaign(extent: Extent) -> None:
    """A campaign, from its start to its sorted file."""
    with tempfile.TemporaryDirectory() as folder:
        file = CampaignFile.open(Path(folder) / "campaign.csv", read_sweep(SCENARIO, [], seeds=extent.seeds))
        began_s = time.perf_counter()
        run_campaign(file, fly=in_processes(CAMPAIGN_WORKERS))
        took_s = time.perf_counter() - began_s
    print(f"\na campaign of {extent.seeds} missions in {CAMPAIGN_WORKERS} processes: {took_s:.1f} s")
    print(verdict("missions per minute", 60 * extent.seeds / took_s, LEAST_MISSIONS_PER_MINUTE))


def measure_growth(config: DroneConfig, extent: Extent) -> None:
    """The cost by number of waypoints, of servers with few in range, and of servers all in range."""
    print("\nwaypoints  servers  in range       ms  µs/waypoint  µs/(waypoint x (1 + in range))")
    grids = [with_grid(config, side) for side in extent.sides]
    in_line, near = (
        [with_servers(config, count, spacing_m=spacing_m) for count in extent.servers]
        for spacing_m in (150.0, 0.5)
    )
    for what, sizes in ("waypoints", grids), ("servers, all near", near):
        costs = measured(what, sizes, rounds=extent.growth_rounds)
        judge("by server in range", costs[-1].by_server_us / costs[0].by_server_us, MOST_GROWTH)
    costs = measured("servers, in a line", in_line, rounds=extent.growth_rounds)
    for count, cost in zip(extent.servers, costs, strict=True):
        if count in MOST_GROWTH_IN_LINE:
            growth = cost.by_waypoint_us / costs[0].by_waypoint_us
            judge(f"with {count} servers", growth, MOST_GROWTH_IN_LINE[count])


@dataclass(frozen=True)
class Cost:
    """What a waypoint costs, and what it costs for itself and each server in range."""

    by_waypoint_us: float
    by_server_us: float


def measured(what: str, sizes: Sequence[DroneConfig], *, rounds: int) -> list[Cost]:
    """The cost of each size; prints a line for each."""
    print(f"- {what}")
    costs = []
    for config in sizes:
        seconds(config, rounds=1, warm_up=0)
    gc.freeze()  # as the processes of a campaign do
    found = [[seconds(config, rounds=1, warm_up=0)[0] for config in sizes] for _ in range(rounds)]
    gc.unfreeze()
    for config, took in zip(sizes, zip(*found, strict=True), strict=True):
        took_s = median(took)
        count, servers, in_range = len(waypoints(config.mission)), len(config.servers), mean_in_range(config)
        cost_us = 1e6 * took_s / count
        costs.append(Cost(cost_us, cost_us / (1 + in_range)))
        print(f"{count:9}  {servers:7}  {in_range:8.1f}  {1e3 * took_s:7.1f}", end="")
        print(f"  {cost_us:11.0f}  {costs[-1].by_server_us:11.0f}")
    return costs


def judge(what: str, growth: float, most: float) -> None:
    """Prints by how much the cost has grown, and whether that is within the limit."""
    print(f"  {what}: grown by {growth:.2f} (limit {most:.2f}: {'ok' if growth <= most else 'MISS'})")


def with_grid(config: DroneConfig, side: int) -> DroneConfig:
    """The same mission over side x side waypoints, all of them in range of every server."""
    grid = GridConfig(columns=side, rows=side, spacing_m=20.0)
    servers = tuple(replace(server, range_m=10_000.0) for server in config.servers)
    return replace(config, mission=replace(config.mission, grid=grid), servers=servers)


def with_servers(config: DroneConfig, count: int, *, spacing_m: float) -> DroneConfig:
    """The same mission with copies of the first server, eastwards from its place."""
    first = config.servers[0]
    assert first.east_m is not None
    copies = tuple(copy_of(first, number, first.east_m + number * spacing_m) for number in range(count))
    return replace(config, servers=copies)


def copy_of(server: ServerConfig, number: int, east_m: float) -> ServerConfig:
    """The server under another name at another place."""
    return replace(server, name=f"c{number}", network=f"c{number}", address=None, east_m=east_m)


def mean_in_range(config: DroneConfig) -> float:
    """How many servers are in range of a waypoint, on average."""
    areas = server_areas(config).values()
    places = waypoints(config.mission)
    return sum(area.contains(place.position) for area in areas for place in places) / len(places)


def seconds(config: DroneConfig, *, rounds: int, warm_up: int) -> list[float]:
    """How long simulations take, after some that do not count."""
    took_s = []
    for _ in range(warm_up + rounds):
        began_s = time.perf_counter()
        run = simulate(config)
        took_s.append(time.perf_counter() - began_s)
        assert run.result.completed, run.failure
    return took_s[warm_up:]


def verdict(what: str, value: float, least: float) -> str:
    """A line that says whether a limit was met."""
    return f"{value:,.0f} {what} (at least {least:,.0f}: {'ok' if value >= least else 'MISS'})"


replace = msgspec.structs.replace

if __name__ == "__main__":
    main()
