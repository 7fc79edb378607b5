"""upwash chaos: flies worlds full of faults and tests the promises."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import OneOf, number, option, seeds, writes
from upwash.errors import UsageError
from upwash.lab.faults.display import replay, show_chaos

ARGUMENTS = {
    "which": OneOf(
        {
            "--seeds N|A..B": option(
                "fly the worlds of the seeds 1 to N, or A to B, on all cores", type=seeds
            ),
            "--seed N": "fly one world, as a failure was reported",
        },
        required=True,
    ),
    "--minutes N": option("with --seeds: begin no world after N minutes", type=number),
    "--workers N": "with --seeds: processes (default: one per core)",
    "--out FILE": writes("with --seeds: write the results there, as JSON"),
    "--log FILE": writes("with --seed: the event log; the scenario is written beside it, as .toml"),
}


def run(options: argparse.Namespace) -> bool:
    """Fly them; true where no promise was broken."""
    if options.seed is not None:
        if (options.minutes, options.workers, options.out) != (None, None, None):
            raise UsageError("--minutes, --workers and --out go with --seeds")
        return replay(options.seed, options.log)
    if options.log is not None:
        raise UsageError("--log goes with --seed: one log holds one world")
    return show_chaos(options.seeds, minutes=options.minutes, workers=options.workers, out=options.out)
