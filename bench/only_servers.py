"""When servers answer photos that no drone can compute, foretold and flown: `python -m bench.only_servers`.

The field of examples/segmenter.toml, 121 photos of 1.5 s at a server, whose ranges are 100, 60 or 40 m. *Foretold* is
what `upwash check` says, without noise; *flown* is the mean of missions with 3 % noise on calls and 2 % on legs. Each
answer's time in flight is compared with the one foretold. The bare alternative is the same mission that asks for
nothing, in the same run.
"""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

from bench.program import command_line

from upwash.config.drone_file import drone_config
from upwash.eventlog import schema
from upwash.lab.processes import in_processes
from upwash.lab.run import simulate

FILE = Path(__file__).resolve().parent.parent / "examples" / "segmenter.toml"
MANNERS: Mapping[str, tuple[str, bool]] = {  # stay_or_go, whether in rows
    "stops": ("stay", False),
    "stops, goes on": ("go", False),
    "rows": ("stay", True),
}
RANGES_M = (100.0, 60.0, 40.0)
NOISE = {"call": 0.03, "leg": 0.02}
SEEDS = 10


class Flight(NamedTuple):
    """One mission to be flown; seed 0 is without noise, and a range of 0 without servers."""

    manner: str
    range_m: float
    seed: int


class Flown(NamedTuple):
    """Its time, when each photo was answered (by its waypoint), and how long after the call."""

    mission_s: float
    answered_s: dict[int, float]
    delays_s: list[float]


def scenario(flight: Flight) -> dict[str, Any]:
    """The scenario of the flight."""
    document = copy.deepcopy(tomllib.loads(FILE.read_text()))
    stay_or_go, in_rows = MANNERS[flight.manner]
    document["policy"] = {"stay_or_go": stay_or_go}
    if in_rows:
        document["mission"]["photos"] = {"every_m": 20.0}
    if flight.seed:
        document |= {"noise": NOISE, "seed": flight.seed}
    for server in document["server"]:
        server["range_m"] = flight.range_m or 1.0
    if not flight.range_m:
        document["policy"]["name"] = "local-only"
    return document


def fly(flight: Flight) -> tuple[Flight, Flown]:
    """The flight and what came of it."""
    run = simulate(drone_config(scenario(flight), FILE))
    assert run.result.completed
    began_s = run.events[-1].t - run.result.mission_time_s
    calls = [event for event in run.events if isinstance(event, schema.Call)]
    answered_s = {call.waypoint: call.t - began_s for call in calls if call.waypoint is not None}
    return flight, Flown(run.result.mission_time_s, answered_s, [call.delay_s for call in calls])


def main() -> None:
    """Flies all of them and prints the table."""
    options = command_line("only_servers", __doc__).parse_args()
    ranges_m = RANGES_M[-1:] if options.quick else RANGES_M
    seeds = range(1, 2 if options.quick else 1 + SEEDS)
    wanted = [
        Flight(manner, range_m, seed)
        for manner, range_m in itertools.product(MANNERS, (0.0, *ranges_m))
        for seed in (0, *seeds)
    ]
    with in_processes(fly, wanted) as results:
        flown = dict(results)
    print(
        "| drone | ranges | answered | half after | the last after | min, foretold | flown | beside none | off by |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for manner, range_m in itertools.product(MANNERS, ranges_m):
        foretold = flown[Flight(manner, range_m, 0)]
        flights = [flown[Flight(manner, range_m, seed)] for seed in seeds]
        bare_s = fmean(flown[Flight(manner, 0.0, seed)].mission_s for seed in seeds)
        off_s = [
            abs(flight.answered_s[photo] - at_s)
            for flight in flights
            for photo, at_s in foretold.answered_s.items()
            if photo in flight.answered_s
        ]
        mission_s = fmean(flight.mission_s for flight in flights)
        cells = (
            manner,
            f"{range_m:g} m",
            f"{fmean(len(flight.answered_s) for flight in flights):.1f} of 121",
            f"{fmean(median(flight.delays_s) for flight in flights):.1f} s",
            f"{fmean(max(flight.delays_s) for flight in flights):.0f} s",
            f"{foretold.mission_s / 60:.1f}",
            f"{mission_s / 60:.1f}",
            f"{mission_s / bare_s:.2f}",
            f"{median(off_s):.1f} s",
        )
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
