"""upwash campaign: simulates many missions."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import OneOf, figures_of, figures_with, reads, repeated, seeds_of, writes
from upwash.lab.campaigns.campaign import in_processes, on_cluster
from upwash.lab.campaigns.display import show_campaign
from upwash.lab.campaigns.sweep import read_sweep
from upwash.lab.processes import cores

ARGUMENTS = {
    "scenario": reads("the scenario, a TOML file"),
    **seeds_of("fly each combination"),
    "--set KEY=V1,V2": repeated(
        "fly it with each of these values of a key, such as policy.gain_wait or server.s1.range_m", "settings"
    ),
    "where": OneOf(
        {
            "--workers N": "processes here (default: one per core)",
            "--cluster ADDRESS": "fly on a Dask cluster, such as tcp://HOST:8786",
        }
    ),
    "--out FILE": writes(
        "a .csv or .parquet file; an interrupted campaign is continued there (default: one in runs/)"
    ),
    **figures_with("the mission times with their confidence"),
}


def run(options: argparse.Namespace) -> bool:
    """Fly them all and print the means; true where each mission was completed."""
    sweep = read_sweep(options.scenario, options.settings, seeds=options.seeds)
    workers = None if options.cluster else options.workers or cores()
    fly = on_cluster(options.cluster) if options.cluster else in_processes(workers)
    return show_campaign(sweep, options.out, fly=fly, workers=workers, figures=figures_of(options))
