"""upwash images: lists what a daemon can run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    images = commands.add_parser("images", help="list the services that a daemon can run, and what of")
    images.add_argument("--config", type=Path, required=True, help="the daemon's configuration, a TOML file")
    images.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Prints a table; false where a service of the configuration could not run."""
    import asyncio

    from rich.console import Console
    from rich.table import Column, Table

    from upwash.config import read_daemon_config
    from upwash.packaging.shipping import list_images

    offers = asyncio.run(list_images(read_daemon_config(options.config)))
    table = Table("service", Column("program", overflow="fold"), "image", "made with", box=None)
    for offer in offers:
        table.add_row(offer.service, offer.program, offer.image, offer.made_with)
    Console(markup=False).print(table)
    return all(offer.can_run for offer in offers)
