"""upwash check: says what a mission will be like, and what is not right, before take-off."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import count, flown_by

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    check = commands.add_parser("check", help="predict a mission and say what will hurt, before take-off")
    check.add_argument("config", type=Path, help="the drone's configuration or a scenario, a TOML file")
    check.add_argument(
        "--seeds", type=count, default=5, metavar="N",
        help="simulated missions for each prediction, where there is noise (default: 5)",
    )  # fmt: skip
    check.add_argument(
        "--workers", type=count, metavar="N", help="processes, where they pay (default: one per core)"
    )
    check.add_argument(
        "--place", type=count, default=0, metavar="N", help="suggest where N more servers would help most"
    )
    check.add_argument("--figures", type=Path, metavar="DIR", help="draw the coverage there")
    what = check.add_mutually_exclusive_group()
    what.add_argument("--json", action="store_true", help="print what was found as one JSON object")
    what.add_argument(
        "--networks", action="store_true", help="only see whether each server's network can be joined"
    )
    what.add_argument(
        "--vehicle",
        action="store_true",
        help="only connect to the vehicle, and see whether its dead man is ready",
    )
    what.add_argument(
        "--install-dead-man",
        action="store_true",
        help="connect to the vehicle, which stands disarmed, and put the dead man into its autopilot",
    )
    check.add_argument("--autopilot", metavar="CONNECTION", help="the vehicle, instead of the configured one")
    check.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Checks and prints what it found; whether there is nothing to warn of."""
    if options.networks:
        from rich.console import Console

        from upwash.config import read_drone_config
        from upwash.preflight.networks import check_networks

        return check_networks(read_drone_config(options.config), Console(markup=False))
    if options.vehicle or options.install_dead_man:
        from rich.console import Console

        from upwash.config import read_drone_config
        from upwash.preflight.vehicle import check_vehicle

        config = flown_by(read_drone_config(options.config), options.autopilot)
        console = Console(markup=False)
        return check_vehicle(config, console, install_dead_man=options.install_dead_man)
    from upwash.lab.campaign import here_first
    from upwash.preflight.display import show_check

    return show_check(
        options.config,
        seeds=options.seeds,
        servers_to_place=options.place,
        as_json=options.json,
        figures=options.figures,
        fly=here_first(options.workers),
    )
