"""upwash keys: makes an authority and certificates."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import announce
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    keys = commands.add_parser("keys", help="make an authority and certificates for servers and drones")
    keys.add_argument("folder", type=Path, help="where they go; an authority that is there is used again")
    keys.add_argument(
        "--server", action="append", default=[], metavar="NAME[,NAME]",
        help="a certificate for a daemon that acts as the server, or as each of several",
    )  # fmt: skip
    keys.add_argument(
        "--drone", action="append", default=[], metavar="NAME", help="a certificate for a drone"
    )
    keys.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Makes them and says which files they are in."""
    from upwash.real.credentials import make_keys

    if not options.server and not options.drone:
        raise UsageError("nothing to make: name at least one --server or --drone")
    servers = [names.split(",") for names in options.server]
    for file in make_keys(options.folder, servers=servers, drones=options.drone):
        announce(str(file))
    return True
