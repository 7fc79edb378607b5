"""What each of upwash's mechanisms gains: `python -m bench.gains`.

Flies the thesis's cells, the scenarios and failing servers under a ladder of variants. Each variant has one mechanism
more than the variant before. The mission times stand beside the theoretical minimum: docs/science.md.
`--keep` leaves the mission times in bench/results; `--figure FILE` draws what is kept there and flies nothing.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

from bench.gains.kept import TABLE, Kept, Missions, read, write
from bench.gains.ladder import LADDER, Part, fly, parts, worlds
from bench.gains.tables import Flown, tables
from bench.program import command_line, machine
from bench.results import FOLDER, leave
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

from upwash.lab import processes

SEEDS = 30


def main() -> None:
    """Flies and prints, or draws."""
    parser = command_line("gains", __doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--keep", action="store_true", help="leave the mission times in bench/results")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw what is kept, and fly nothing")
    options = parser.parse_args()
    if options.figure:
        from bench.gains.figure import draw

        draw(read(TABLE), options.figure)
        return
    print(machine())
    begun_s = time.monotonic()
    flown = list(worlds())[:1] if options.quick else list(worlds())
    missions = fly_all(parts(flown, seeds=2 if options.quick else options.seeds))
    kept = Kept([variant.name for variant in LADDER], missions)
    if options.keep:
        write(TABLE, kept)
        figures = Flown(
            worlds=len(flown),
            seeds=options.seeds,
            missions=len(missions) * len(LADDER),
            cores=os.cpu_count() or 1,
            took_s=round(time.monotonic() - begun_s, 1),
        )
        leave(FOLDER / "gains.json", command="python -m bench.gains --keep", figures=figures)
    print(f"\n{tables(kept)}")


def fly_all(flown: Sequence[Part]) -> list[Missions]:
    """The missions in the parts' order, on all cores; a bar shows how far they are."""
    order = {(part.group, part.world, part.config.seed): number for number, part in enumerate(flown)}
    missions: list[Missions] = []
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar, processes.here_first(fly, flown) as results:
        task = bar.add_task("worlds and seeds", total=len(flown))
        for result in results:
            missions.append(result)
            bar.advance(task)
    return sorted(missions, key=lambda each: order[each.group, each.world, each.seed])


if __name__ == "__main__":
    main()
