"""upwash serve: runs an edge daemon."""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import resource

from upwash.cli.arguments import announce, config_of, option, require_linux
from upwash.config import DaemonConfig, read_daemon_config
from upwash.launch.daemon import keep_heaps_few, serve
from upwash.real.host.first_process import leave_first_process
from upwash.real.host.log import log_json, log_text
from upwash.real.host.service_manager import ServiceManager
from upwash.real.link.hand_over import handed_over

_log = logging.getLogger("upwash.serve")


ARGUMENTS = {
    **config_of("daemon"),
    "--log-format": option("of the log on standard error", choices=("text", "json"), default="text"),
}


def run(options: argparse.Namespace) -> None:
    """Serve until a signal ends it."""
    require_linux("serve")
    leave_first_process()
    before = handed_over(os.environ)
    manager = ServiceManager.taken_from(os.environ)
    keep_heaps_few()
    config = read_daemon_config(options.config)
    (log_json if options.log_format == "json" else log_text)()
    # Each connection is an open file: as many as the system allows, or a thousand strangers would keep drones out.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    _warn_without_revocations(config)
    names = ", ".join(identity.name for identity in config.identities)
    asyncio.run(
        serve(
            config,
            read_again=lambda: _warn_without_revocations(read_daemon_config(options.config)),
            ready=lambda address: announce(f"{names} ready at {address}"),
            manager=manager,
            before=before,
        )
    )


def _warn_without_revocations(config: DaemonConfig) -> DaemonConfig:
    """Warn where no list of revoked certificates is read: revoking a certificate changes nothing here."""
    if config.keys and not config.keys.revoked:
        _log.warning(
            "no list of revoked certificates is read: put the revoked.txt of `upwash keys DIR --revoke NAME` beside "
            "%s, or name it as keys.revoked; until then no certificate can be taken back",
            config.keys.authority,
        )
    return config
