"""upwash check: says what a mission will be like, and what is not right, before take-off."""

from __future__ import annotations

import argparse

from msgspec.structs import replace
from rich.console import Console

from upwash.cli.arguments import OneOf, figures_of, figures_with, flown_by, option, reads
from upwash.config.drone_file import read_drone_config, refuse_several
from upwash.errors import UsageError
from upwash.lab.campaigns.campaign import here_first
from upwash.lab.run import renders_photos
from upwash.preflight.capacity import show_capacity
from upwash.preflight.check import read_plan
from upwash.preflight.display import show_check
from upwash.preflight.fleet import show_fleet_check
from upwash.preflight.prediction import MOST_WORLDS
from upwash.support.progress import work

ARGUMENTS = {
    "config": reads("the drone's configuration or a scenario, a TOML file"),
    "--seeds N": option(
        "where there is noise, fly each prediction with each of the seeds 1 to N (default: 5, and fewer for more "
        "than 48 photos)"
    ),
    "--workers N": "processes, where they pay (default: one per core; one for photos of camera.park_seed)",
    "--place N": option("suggest where N more servers would help most, together", default=0),
    "--place-all": "suggest where the file's own servers would help most, together",
    **figures_with("the coverage"),
    "--json": "print the results as one JSON object",
    "only": OneOf(
        {
            "--capacity": "only fly the mission with more and more drones at once, and say how many the servers "
            "carry",
            "--networks": "only see whether each server's network can be joined",
            "--servers": "only join each server's network, have it start the drone's services, and call them as a "
            "flight does",
            "--vehicle": "only connect to the vehicle, and see whether its dead man is ready",
            "--install-dead-man": "connect to the vehicle, which stands disarmed, and put the dead man into its "
            "autopilot",
        }
    ),
    "--autopilot CONNECTION": "the vehicle, instead of the configured one",
}


def run(options: argparse.Namespace) -> bool:
    """Check and print what was found; true where there is nothing to warn of."""
    if options.networks or options.servers or options.vehicle or options.install_dead_man:
        if options.json:
            raise UsageError("--json prints predictions and capacity only: leave it out")
        return _survey(options)
    plan = read_plan(options.config)
    plan = replace(plan, config=flown_by(plan.config, options.autopilot))
    if options.capacity:
        return show_capacity(plan.config, str(plan.file), as_json=options.json)
    if plan.config.drones:
        if options.place or options.place_all or options.figures is not None:
            raise UsageError(
                "--place, --place-all and --figures are of one drone's way, and this file has [[drone]] tables: "
                "leave them out, or check a file with one of the drones"
            )
        return show_fleet_check(
            plan, seeds=options.seeds or MOST_WORLDS, as_json=options.json, workers=options.workers
        )
    if options.place and options.place_all:
        raise UsageError("--place adds servers and --place-all moves those of the file: give one of them")
    # a process renders each photo once: several would take longer for that than one for all missions
    workers = options.workers or (1 if renders_photos(plan.config) else None)
    return show_check(
        plan,
        seeds=options.seeds,
        more_servers=0 if options.place_all else options.place or None,
        as_json=options.json,
        figures=figures_of(options),
        fly=here_first(workers),
    )


def _survey(options: argparse.Namespace) -> bool:
    """Survey one thing that a flight needs; true where it is ready."""
    from upwash.preflight.surveys import check_networks, check_servers, check_vehicle

    config = flown_by(read_drone_config(options.config), options.autopilot)
    refuse_several(config, options.config, what="what is looked at")
    console = Console(markup=False)
    if options.networks:
        with work("joining each network"):
            return check_networks(config, console)
    if options.servers:
        with work("calling each server"):
            return check_servers(config, console)
    with work("waiting for what the vehicle says"):
        return check_vehicle(config, console, install_dead_man=options.install_dead_man)
