"""upwash serve: runs an edge daemon."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import announce

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    serve = commands.add_parser("serve", help="run an edge daemon")
    serve.add_argument("--config", type=Path, required=True, help="the daemon's configuration, a TOML file")
    serve.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Serves until it is told to stop."""
    os.environ.setdefault("GRPC_VERBOSITY", "INFO")  # gRPC then says whose certificate it refused, and why
    import logging

    from upwash.config import read_daemon_config
    from upwash.launch import serve

    config = read_daemon_config(options.config)
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    names = ", ".join(identity.name for identity in config.identities)
    asyncio.run(serve(config, ready=lambda address: announce(f"{names} ready at {address}")))
    return True
