"""Answers within 1.5 s where servers stall: `python -m bench.deadlines`, as root.

A server answers a call in about 0.4 s, and one of each twenty, drawn at each server, in 10 s. It computes four calls
at a time, and the drone takes 3 s. *Simulated* are missions over a field with both servers in range. *Flown* are
calls of `upwash fly`, each 2 s after the last one or at its end. The daemons are at the other ends of emulated links
of 54 Mbit/s and 50 ms there and back, with mutual TLS. All ways are flown at the same time, with computers of their
own. The load is the number of calls that servers begin to compute, for each call of the mission. The ranges hold
with a probability of 95 %: those of P99 count calls, the others missions.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import tomli_w
from bench.links.wan import Shape, wan
from bench.program import command_line, machine
from bench.results import FOLDER, leave
from bench.stalling import CALLS, UNCOUNTED, drawn_s

from upwash import read_log
from upwash.config.drone_file import drone_config
from upwash.emulation.enclosure import require_root_and_tools, run_enclosed, settle_in
from upwash.emulation.namespaces import LinkEnd, inside, make_namespace
from upwash.eventlog import schema
from upwash.lab.observer import Observation
from upwash.lab.processes import in_processes
from upwash.lab.run import simulate_fleet
from upwash.launch.processes import ready_program
from upwash.real.trust.authority import make_keys
from upwash.support.confidence import mean_of
from upwash.support.loading import module_command

WITHIN_S = 1.5
WAYS: Mapping[str, tuple[int, dict[str, Any]]] = {  # how many servers, and [policy]
    "one server": (1, {"hedge": False}),
    "one server, hedged by the drone": (1, {}),
    "two servers, with the deadline": (2, {}),
}
LOCAL_S, REMOTE_S = 3.0, 0.4
SHAPE = Shape(round_trip_s=0.05, rate_bit_s=54e6)
LINK_S = 0.07  # that calls over it take longer, as measured
SEEDS, CALLS_FLOWN, TIMES = 30, 200, 1000
_FOUND = "found.json"
GRID = {"columns": 20, "rows": 10, "spacing_m": 10.0}
QUICK_GRID = GRID | {"rows": 2}
PROGRAM = Path(__file__).with_name("stalling.py")
DRONE = "drone"
SERVERS = ("s1", "s2")
HOME = {"latitude_deg": 39.3666, "longitude_deg": 22.9507}
VEHICLE = ("vehicle", "--listen", "udp:127.0.0.1:0", "--home", "39.3666,22.9507", "--armable-after", "1")


class Mission(NamedTuple):
    """A mission to be simulated."""

    way: str
    seed: int
    times: Path
    is_quick: bool


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """One mission: the delay of each call, and how many calls servers began to compute."""

    delays_s: list[float]
    computed: int

    @property
    def in_time(self) -> float:
        """The share of the calls that was answered in time."""
        return sum(delay_s <= WITHIN_S for delay_s in self.delays_s) / len(self.delays_s)

    @property
    def load(self) -> float:
        """The calls that servers computed, for each call of the mission."""
        return self.computed / len(self.delays_s)


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """The missions of one way."""

    where: str
    way: str
    missions: list[Seen]

    def row(self) -> str:
        """They as a row of the table."""
        missions = self.missions
        delays_s = sorted(itertools.chain.from_iterable(seen.delays_s for seen in missions))
        low_s, p99_s, high_s = _p99(delays_s)
        cells = (
            self.where,
            self.way,
            f"{len(delays_s):,}",
            _mean([seen.in_time for seen in missions], 4),
            f"{p99_s:.2f} s ({low_s:.2f} to {high_s:.2f})",
            _mean([seen.load for seen in missions], 3),
        )
        return f"| {' | '.join(cells)} |"


HEAD = f"""\
| calls | way | number | in {WITHIN_S:g} s | P99 | load |
|---|---|---|---|---|---|"""


def _mean(values: Sequence[float], digits: int) -> str:
    mean = mean_of(values)
    margin = "" if math.isinf(mean.margin) else f" ± {mean.margin:.{digits}f}"
    return f"{mean.value:.{digits}f}{margin}"


def _p99(ordered: Sequence[float]) -> tuple[float, float, float]:
    """The P99 of sorted delays, between the two of them that it lies between with a probability of 95 %."""
    count = len(ordered)
    rank, off = 0.99 * count, 1.96 * math.sqrt(count * 0.99 * 0.01)
    low, middle, high = (min(count, max(1, math.ceil(at))) for at in (rank - off, rank, rank + off))
    return ordered[low - 1], ordered[middle - 1], ordered[high - 1]


def main() -> int:
    """Prints the table; 1 where the enclosed program failed."""
    options = _options()
    if options.enclosed:
        return _fly_all(options.enclosed, options)
    require_root_and_tools()
    print(f"{machine()}\n\n{HEAD}", flush=True)
    with tempfile.TemporaryDirectory(prefix="deadlines-") as name:
        folder = Path(name)
        found = [] if options.part == "flown" else list(_simulated(folder, options))
        for figures in found:
            print(figures.row(), flush=True)
        if options.part != "simulated":
            if run_enclosed("-m", "bench.deadlines", "--enclosed", name, *sys.argv[1:]):
                return 1
            found += msgspec.json.decode((folder / _FOUND).read_bytes(), type=list[Figures])
    if options.keep:
        leave(FOLDER / "deadlines.json", command="python -m bench.deadlines --keep", figures=found)
    return 0


def _options() -> argparse.Namespace:
    parser = command_line("deadlines", __doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="the missions simulated of each way")
    parser.add_argument("--calls", type=int, default=CALLS_FLOWN, help="the calls flown of each way")
    parser.add_argument("--part", choices=("simulated", "flown"), help="only that part of the table")
    parser.add_argument("--keep", action="store_true", help="leave the figures in bench/results")
    parser.add_argument("--enclosed", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _document(way: str, times: Path) -> dict[str, Any]:
    """The drone's configuration, all but its mission; `times` were measured of both servers before."""
    servers, policy = WAYS[way]
    deadline = {"deadline": {"s": WITHIN_S, "p": 0.99, "extra": 0.1}} if servers > 1 else {}
    near = {"east_m": 100.0, "north_m": 50.0, "range_m": 500.0, "times_csv": str(times)}
    return {
        "service": [
            {"name": "stalling", "program": f"{PROGRAM}:Stalling", "local_call_s": LOCAL_S, **deadline}
        ],
        "server": [{**near, "name": name, "remote_call_s": REMOTE_S} for name in SERVERS[:servers]],
        "network": {"radios": servers},
        "policy": policy,
    }


def _write_times(file: Path, *, link_s: float = 0.0) -> None:
    rows = (f"stalling.look,{drawn_s(number, seed=9) + link_s:.3f}\n" for number in range(TIMES))
    file.write_text(f"operation,seconds\n{''.join(rows)}")


# --- simulated ----------------------------------------------------------------------------------------------


def _simulated(folder: Path, options: argparse.Namespace) -> Iterator[Figures]:
    times = folder / "simulated.csv"
    _write_times(times)
    seeds = range(1, 1 + (2 if options.quick else options.seeds))
    wanted = [Mission(way, seed, times, options.quick) for way, seed in itertools.product(WAYS, seeds)]
    with in_processes(simulated, wanted) as results:
        flown = dict(results)
    for way in WAYS:
        own = [flown[mission] for mission in wanted if mission.way == way]
        yield Figures(where="simulated", way=way, missions=own)


def simulated(mission: Mission) -> tuple[Mission, Seen]:
    """Simulates it."""
    document = _document(mission.way, mission.times) | {
        "seed": mission.seed,
        "mission": {"program": f"{PROGRAM}:survey", "grid": QUICK_GRID if mission.is_quick else GRID},
    }
    for server in document["server"]:
        server |= {"check_s": 3.0, "check_running_s": 1.0}
        server["truth"] = {"service_csv": str(mission.times)}
    facts: list[Observation] = []
    (run,) = simulate_fleet([drone_config(document, PROGRAM)], seen=facts)
    assert run.result.completed, run.failure
    delays_s = [call.delay_s for call in run.result.calls]
    return mission, Seen(delays_s=delays_s, computed=sum(fact.event == "served" for fact in facts))


# --- flown --------------------------------------------------------------------------------------------------


def _fly_all(folder: Path, options: argparse.Namespace) -> int:
    settle_in(lambda: os._exit(1))
    make_keys(folder / "keys", servers=[[name] for name in SERVERS], drones=[DRONE])
    _write_times(folder / "flown.csv", link_s=LINK_S)
    ways = list(WAYS)[-1:] if options.quick else list(WAYS)
    calls = 5 if options.quick else options.calls
    with ThreadPoolExecutor(len(ways)) as pool:
        seen = pool.map(lambda way: _flown(way, folder / way, calls=calls), ways)
        found = [Figures(where="flown", way=way, missions=[own]) for way, own in zip(ways, seen, strict=True)]
    for figures in found:
        print(figures.row(), flush=True)
    (folder / _FOUND).write_bytes(msgspec.json.encode(found))
    return 0


def _flown(way: str, folder: Path, *, calls: int) -> Seen:
    """Makes the calls of a drone on the ground; each way has the same stalls, and namespaces of its own."""
    folder.mkdir()
    drone, log = f"{DRONE}{list(WAYS).index(way)}", folder / "events.jsonl"
    make_namespace(drone)
    document = _document(way, folder.parent / "flown.csv") | {
        "mission": {"program": f"{PROGRAM}:on_the_ground", "home": HOME, "waypoints_m": [[0.0, 0.0]]},
        "keys": _keys(folder, DRONE),
    }
    document["service"][0]["local_pace_s"] = LOCAL_S
    with contextlib.ExitStack() as stack:
        for number, server in enumerate(document["server"], start=1):
            name, namespace = server["name"], f"{server['name']}-{drone}"
            own, end = (
                LinkEnd(drone, f"to-{name}", f"10.77.{number}.1"),
                LinkEnd(namespace, "wan", f"10.77.{number}.2"),
            )
            make_namespace(namespace)
            stack.enter_context(wan(SHAPE, own, end))
            server["address"] = f"{end.address}:7070"
            config = folder / f"{name}.toml"
            config.write_text(tomli_w.dumps(_daemon(name, server["address"], number, folder)))
            serve = ("serve", "--config", str(config))
            stack.enter_context(ready_program(name, folder, *serve, through=inside(namespace)))
        vehicle = stack.enter_context(ready_program("vehicle", folder, *VEHICLE, through=inside(drone)))
        document["autopilot"] = {"connection": vehicle.replace("udp:", "udpout:")}
        file = folder / "drone.toml"
        file.write_text(tomli_w.dumps(document))
        with (folder / "drone.log").open("wb") as said:
            subprocess.run(
                [*inside(drone), *module_command("upwash", "fly", "--config", str(file), "--log", str(log))],
                env=os.environ | {CALLS: str(calls)},
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                check=True,
            )
    counted = [event for event in read_log(log) if isinstance(event, schema.Call)][UNCOUNTED:]
    begun_s = [float(at_s) for file in folder.glob("*.begun") for at_s in file.read_text().split()]
    return Seen(
        delays_s=[call.delay_s for call in counted],
        computed=sum(at_s >= counted[0].at_s for at_s in begun_s),  # the clock is the same everywhere
    )


def _daemon(name: str, address: str, seed: int, folder: Path) -> dict[str, Any]:
    settings = {"seed": seed, "file": str(folder / f"{name}.begun")}
    return {
        "listen": address,
        "runtime": {"sandbox": "off"},
        "keys": _keys(folder, name),
        "service": [{"name": "stalling", "program": f"{PROGRAM}:Stalling", "settings": settings}],
        "server": [{"name": name}],
    }


def _keys(folder: Path, name: str) -> dict[str, str]:
    keys = folder.parent / "keys"
    files = {"authority": "authority.pem", "certificate": f"{name}.pem", "key": f"{name}.key"}
    return {key: str(keys / file) for key, file in files.items()}


if __name__ == "__main__":
    sys.exit(main())
