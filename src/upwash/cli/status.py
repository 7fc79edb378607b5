"""upwash status: asks an edge daemon how it is."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import announce

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    status = commands.add_parser("status", help="ask an edge daemon for its leases, instances and refusals")
    status.add_argument("address", metavar="ADDRESS", help="of the daemon: host:port, or unix:path")
    status.add_argument("--server", metavar="NAME", default="", help="a server that the daemon acts as")
    status.add_argument("--operator", metavar="NAME", default="operator", help="whose certificate to show")
    status.add_argument(
        "--keys", type=Path, metavar="DIR",
        help="where authority.pem, NAME.pem and NAME.key lie; without it none are used, on this machine only",
    )  # fmt: skip
    status.add_argument("--json", action="store_true", help="print the daemon's answer as JSON, for programs")
    status.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Prints it."""
    import msgspec
    from rich.console import Console

    from upwash.cli.daemon_status import print_status
    from upwash.launch.status import ask_status

    reply = asyncio.run(
        ask_status(options.address, server=options.server, operator=options.operator, keys=options.keys)
    )
    if options.json:
        announce(msgspec.json.encode(reply).decode())
    else:
        print_status(reply, Console(markup=False))
    return True
