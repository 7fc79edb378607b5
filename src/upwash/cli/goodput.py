"""upwash goodput: computes a table of goodput by distance."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import count, option, seeds_of, writes
from upwash.emulation.goodput import Measurement, measure, write_table
from upwash.emulation.native import WIFI
from upwash.support.progress import work

ARGUMENTS = {
    "radio": option("the radio's settings", choices=("disc12", "disc54")),
    "--out FILE": writes("the csv file to write", required=True),
    "--range M": option("the radio's range (default: 100)", type=count, default=100, dest="range_m"),
    "--request BYTES": option(
        "size of a transfer (default: 430000)", type=count, default=430_000, dest="request_bytes"
    ),
    **seeds_of("measure a transfer at each distance", default=20),
}


def run(options: argparse.Namespace) -> None:
    """Compute the table and write the file."""
    step_m = options.range_m / 20
    measurement = Measurement(
        settings=WIFI[options.radio].ending_at(options.range_m),
        distances_m=[step * step_m for step in range(25)],
        request_bytes=options.request_bytes,
        seeds=options.seeds,
    )
    with work("distances", len(measurement.distances_m)) as measured:
        table = measure(measurement, measured=measured)
    write_table(options.out, measurement, table)
    print(f"written: {options.out}")
