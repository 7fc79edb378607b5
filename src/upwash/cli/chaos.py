"""upwash chaos: flies worlds full of faults and tests the promises."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import OneOf, option
from upwash.errors import UsageError
from upwash.lab.faults.display import replay, show_chaos


def seeds(text: str) -> range:
    """Whole numbers from 1 to N, or from A to B where they are written A..B."""
    first, dots, last = text.partition("..") if ".." in text else ("1", "..", text)
    if not (dots and first.isdecimal() and last.isdecimal() and 1 <= int(first) <= int(last)):
        raise argparse.ArgumentTypeError(f"{text!r} is not N or A..B, such as 200 or 1..2000")
    return range(int(first), int(last) + 1)


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
    "--minutes N": option("with --seeds: begin no world after N minutes", type=float),
    "--workers N": "with --seeds: processes (default: one per core)",
    "--out FILE": "with --seeds: write the results there, as JSON",
    "--log FILE": "with --seed: the event log; the scenario is written beside it, as .toml",
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
