"""upwash keys: makes an authority and certificates, and revokes them."""

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
    keys.add_argument(
        "--operator", action="append", default=[], metavar="NAME",
        help="a certificate for a person who may ask a daemon for its status",
    )  # fmt: skip
    keys.add_argument(
        "--revoke", action="append", default=[], metavar="NAME",
        help="put the certificate of that name on the list of those that daemons refuse",
    )  # fmt: skip
    keys.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Does so and says which files were written."""
    from upwash.real.credentials import make_keys, revoke

    wanted = options.server or options.drone or options.operator
    if not wanted and not options.revoke:
        raise UsageError(
            "nothing to make: name at least one --server, --drone or --operator, or --revoke one"
        )
    if options.revoke:
        announce(str(revoke(options.folder, options.revoke)))
    if wanted:
        servers = [names.split(",") for names in options.server]
        made = make_keys(options.folder, servers=servers, drones=options.drone, operators=options.operator)
        for file in made:
            announce(str(file))
    return True
