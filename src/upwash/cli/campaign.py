"""upwash campaign: simulates many missions."""

from __future__ import annotations

import argparse
from pathlib import Path

from upwash.cli.arguments import add_figures, add_seeds, count, figures_of
from upwash.lab.campaigns.campaign import in_processes, on_cluster
from upwash.lab.campaigns.display import show_campaign
from upwash.lab.campaigns.sweep import read_sweep
from upwash.lab.processes import cores


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("scenario", type=Path, help="the scenario, a TOML file")
    add_seeds(parser, "fly each combination")
    parser.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=V1,V2",
        help="fly it with each of these values of a key, such as policy.gain_wait or server.s1.range_m",
    )  # fmt: skip
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=count, metavar="N", help="processes here (default: one per core)")
    where.add_argument("--cluster", metavar="ADDRESS", help="fly on a Dask cluster, such as tcp://HOST:8786")
    parser.add_argument(
        "--out", type=Path, metavar="FILE",
        help="a .csv or .parquet file; an interrupted campaign is continued there (default: one in runs/)",
    )  # fmt: skip
    add_figures(parser, "the mission times with their confidence")


def run(options: argparse.Namespace) -> bool:
    """Fly them all and print the means; true where each mission was completed."""
    sweep = read_sweep(options.scenario, options.settings, seeds=options.seeds)
    workers = None if options.cluster else options.workers or cores()
    fly = on_cluster(options.cluster) if options.cluster else in_processes(workers)
    return show_campaign(sweep, options.out, fly=fly, workers=workers, figures=figures_of(options))
