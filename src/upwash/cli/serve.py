"""upwash serve: runs an edge daemon."""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import announce

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands
    from upwash.config import DaemonConfig

_log = logging.getLogger("upwash.serve")


def add(commands: Commands) -> None:
    """Adds the command."""
    serve = commands.add_parser("serve", help="run an edge daemon")
    serve.add_argument("--config", type=Path, required=True, help="the daemon's configuration, a TOML file")
    serve.add_argument(
        "--log-format", choices=("text", "json"), default="text", help="of the log on standard error"
    )
    serve.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Serves until it is told to stop."""
    from upwash.real.link.hand_over import handed_over

    before = handed_over(os.environ)
    service_manager = os.environ.pop("NOTIFY_SOCKET", "")  # instances have nothing to tell it
    import resource

    from upwash.config import read_daemon_config
    from upwash.launch.daemon import serve
    from upwash.real.host.log import log_json, log_text
    from upwash.real.host.service_manager import ServiceManager
    from upwash.real.instances.memory import keep_heaps_few

    keep_heaps_few()
    config = read_daemon_config(options.config)
    (log_json if options.log_format == "json" else log_text)()
    # Each connection is an open file: as many as the system allows, or a thousand strangers would keep drones out.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    _say_if_none_is_refused(config)
    names = ", ".join(identity.name for identity in config.identities)
    asyncio.run(
        serve(
            config,
            read_again=lambda: _say_if_none_is_refused(read_daemon_config(options.config)),
            ready=lambda address: announce(f"{names} ready at {address}"),
            manager=ServiceManager(service_manager),
            before=before,
        )
    )
    return True


def _say_if_none_is_refused(config: DaemonConfig) -> DaemonConfig:
    """Warns where no list of revoked certificates is read, so that revoking one changes nothing here."""
    if config.keys and not config.keys.revoked:
        _log.warning(
            "no list of revoked certificates is read: put the revoked.txt of `upwash keys DIR --revoke NAME` beside "
            "%s, or name it as keys.revoked; until then no certificate can be taken back",
            config.keys.authority,
        )
    return config
