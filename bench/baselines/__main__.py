"""What servers are worth beside a drone that is flown well, and published clients: `python -m bench.baselines`.

Each part is one table of docs/science.md; `--part` chooses one, and `--keep` leaves its missions in bench/results.

    named     the scenarios, flown alone and with servers: waiting, learning to go on, and on the move
    speeds    the thesis's field with onboard computers of several speeds, cool and hot
    drawn     the held-out worlds of `upwash worlds`
    clients   a drone that races with the server, and one that sends each call to every server
    knowing   staying or going with known probabilities
    reserving servers reserved before the flight
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from bench.baselines import knowing, reserving, worlds
from bench.baselines.kept import PARTS, Measured, file_of, flights_of, shown
from bench.baselines.manners import Part, fly
from bench.gains.kept import Kept, write
from bench.program import command_line, machine
from bench.results import FOLDER, leave
from msgspec import to_builtins

from upwash.lab import processes

T = TypeVar("T")
R = TypeVar("R")
SEEDS, DRAWN = (
    {"named": 5, "speeds": 5, "clients": 3, "knowing": 5, "reserving": 2},
    {"drawn": 400, "clients": 100},
)


def main() -> None:
    """Flies and prints."""
    parser = command_line("baselines", __doc__)
    parser.add_argument("--part", choices=PARTS, action="append", help="fly only this one (default: all)")
    parser.add_argument("--seeds", type=int, help="of each mission (default: as the page has them)")
    parser.add_argument("--worlds", type=int, help="drawn ones (default: as the page has them)")
    parser.add_argument("--workers", type=int, help="processes (default: one per core)")
    parser.add_argument("--keep", action="store_true", help="leave the missions in bench/results")
    options = parser.parse_args()
    print(machine())
    for part in options.part or PARTS:
        begun_s = time.monotonic()
        seeds = 2 if options.quick else options.seeds or SEEDS.get(part, 1)
        count = 3 if options.quick else options.worlds or DRAWN.get(part, 0)
        figures: Any = None
        if part == "knowing":
            figures = list(
                knowing.rows(dict(_spread(knowing.fly, _decisions(seeds, options.quick), options.workers)))
            )
        elif part == "reserving":
            fleets = [
                reserving.Fleet(layout, drones, seed)
                for layout in list(reserving.LAYOUTS)[: 1 if options.quick else None]
                for drones in (reserving.QUICK_FLEETS if options.quick else reserving.FLEETS)
                for seed in range(1, seeds + 1)
            ]
            figures = list(reserving.rows(dict(_spread(reserving.fly, fleets, options.workers))))
        missions = _spread(fly, _parts(part, seeds, count, options.quick), options.workers)
        measured = Measured(
            seeds=seeds,
            worlds=len({(each.group, each.world) for each in missions}),
            missions=flights_of(missions),
            cores=os.cpu_count() or 1,
            took_s=round(time.monotonic() - begun_s, 1),
            figures=to_builtins(figures),
        )
        print(f"\n{shown(part, measured, missions)}", flush=True)
        if options.keep:
            if missions:
                variants = dict.fromkeys(itertools.chain.from_iterable(each.times_s for each in missions))
                write(file_of(part), Kept(list(variants), missions))
            drawn = f" --worlds {count}" if part in ("drawn", "clients") else ""
            often = "" if part == "drawn" else f" --seeds {seeds}"
            command = f"python -m bench.baselines --part {part}{often}{drawn} --keep"
            leave(FOLDER / f"baselines_{part}.json", command=command, figures=measured)


def _parts(part: str, seeds: int, count: int, quick: bool) -> list[Part]:
    match part:
        case "named":
            return list(worlds.named(seeds, quick=quick))
        case "speeds":
            return list(worlds.speeds(seeds, quick=quick))
        case "drawn":
            return list(worlds.drawn(count))
        case "clients":
            return list(worlds.crowded(seeds, count, quick=quick))
    return []


def _decisions(seeds: int, quick: bool) -> list[knowing.Flight]:
    chances = knowing.QUICK_CHANCES if quick else knowing.CHANCES
    return [
        knowing.Flight(*each)
        for each in itertools.product(
            knowing.CALLS[:1] if quick else knowing.CALLS, chances, range(1, seeds + 1)
        )
    ]


def _spread(do: Callable[[T], R], parts: Sequence[T], workers: int | None) -> list[R]:
    """The results in the parts' order."""
    numbers = itertools.count(1)

    def done() -> None:
        if (ready := next(numbers)) % 20 == 0:
            print(f"{ready} of {len(parts)}", file=sys.stderr, flush=True)

    return processes.in_order(do, parts, workers=workers, done=done)


if __name__ == "__main__":
    main()
