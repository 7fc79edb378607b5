"""upwash images: lists what a daemon can run."""

from __future__ import annotations

import argparse
import asyncio

from rich.console import Console
from rich.table import Column, Table

from upwash.cli.arguments import config_of
from upwash.config.daemon import read_daemon_config
from upwash.packaging.shipping import list_images
from upwash.support.progress import work
from upwash.support.tables import show_table

ARGUMENTS = config_of("daemon")


def run(options: argparse.Namespace) -> bool:
    """Print a table; false where a configured service could not run."""
    with work("asking what can run"):
        offers = asyncio.run(list_images(read_daemon_config(options.config)))
    table = Table("service", Column("program", overflow="fold"), "image", "made with", box=None)
    for offer in offers:
        table.add_row(offer.service, offer.program, offer.image, offer.made_with)
    show_table(table, Console(markup=False))
    return all(offer.can_run for offer in offers)
