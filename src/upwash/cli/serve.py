"""upwash serve: runs an edge daemon, and gives one its orders."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path

from upwash.cli.arguments import OneOf, announce, config_of, option, require_linux
from upwash.errors import UsageError

_MOST_PROCESS = 2**22  # of Linux

ARGUMENTS = {
    **config_of("daemon"),
    "--log-format": option("of the log on standard error", choices=("text", "json"), default="text"),
    "orders": OneOf(
        {
            "--check RUNNING": option(
                "print what a start or a reload would refuse and what needs a restart, and end with code 1 then; "
                "RUNNING is what runs now: the daemon's process number, or the file of its configuration",
                nargs="?",
                const="",
            ),
            "--reload PROCESS": option(
                "have the daemon of that process reload, wait for that, and end with code 1 if it refuses a part",
                type=int,
            ),
        }
    ),
}


def run(options: argparse.Namespace) -> bool:
    """Serve until a signal ends it; or give an order, print what is refused, and return whether nothing is."""
    require_linux("serve")
    if options.reload is not None:
        return _ordered(options.reload, "reload", options.config)
    if options.check is not None:
        return _checked(options.config, options.check)
    _serve(options.config, is_json=options.log_format == "json")
    return True


def _serve(config: Path, *, is_json: bool) -> None:
    import asyncio  # and the daemon, which the help does without
    import resource

    from upwash.launch.daemon import keep_heaps_few, serve
    from upwash.real.host.first_process import leave_first_process
    from upwash.real.host.log import log_json, log_text
    from upwash.real.host.service_manager import ServiceManager
    from upwash.real.link.hand_over import handed_over

    leave_first_process()
    before = handed_over(os.environ)
    manager = ServiceManager.taken_from(os.environ)
    keep_heaps_few()
    (log_json if is_json else log_text)()
    # Each connection is an open file: as many as the system allows, or a thousand strangers would keep drones out.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    asyncio.run(
        serve(
            config,
            ready=lambda names, address: announce(f"{names} ready at {address}"),
            manager=manager,
            before=before,
        )
    )


def _checked(config: Path, running: str) -> bool:
    """Print what a start with the configuration, or a reload of what runs now, would refuse."""
    import asyncio

    from upwash.launch.daemon_check import check

    if running.isdecimal():
        return _ordered(int(running), "check", config)
    return _tell(asyncio.run(check(config, Path(running) if running else None)))


def _ordered(process: int, order: str, config: Path) -> bool:
    """Have the daemon of that process, whose configuration is the file, obey an order; print what it refuses."""
    if not 1 <= process <= _MOST_PROCESS:
        raise UsageError(f"{process} is no number of a process")
    from upwash.real.link.orders import give_order

    obeyed = give_order(process, order)
    if Path(obeyed.file).resolve() != config.resolve():
        raise UsageError(f"the daemon of process {process} has another configuration: name {obeyed.file}")
    return _tell(obeyed.refused)


def _tell(refused: Mapping[str, str]) -> bool:
    for part, why in refused.items():
        announce(f"refused: {part}: {why}")
    if not refused:
        announce("nothing is refused")
    return not refused
