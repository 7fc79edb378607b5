"""upwash check: says what is not right before take-off."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    check = commands.add_parser(
        "check", help="check a drone's configuration, and what it needs, before take-off"
    )
    check.add_argument("config", type=Path, help="the drone's configuration, a TOML file")
    check.add_argument(
        "--networks", action="store_true", help="also see whether each server's network can be joined"
    )
    check.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Checks and prints what it found; whether all is well."""
    from rich.console import Console

    from upwash.config import read_drone_config, waypoints

    console = Console(markup=False)
    config = read_drone_config(options.config)
    console.print(
        f"{options.config} is understood: {len(waypoints(config.mission))} waypoints, "
        f"{len(config.services)} services, {len(config.servers)} servers",
        soft_wrap=True,
    )
    if not options.networks:
        return True
    from upwash.preflight import check_networks

    return check_networks(config, console)
