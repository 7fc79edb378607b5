"""What networks and servers say of themselves before take-off, for a person to read."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config import DroneConfig
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.real.network.finding import Finding


def check_networks(config: DroneConfig, console: Console) -> bool:
    """Prints which interfaces and networks can be used, and what to do about the others; whether all can."""
    if config.network.kind != "networkmanager":
        raise UsageError(
            f'network.kind is "{config.network.kind}", so no network is joined: "networkmanager" joins those of '
            "the servers (docs/networks.md)"
        )
    from upwash.launch.survey import survey_networks

    return _print(asyncio.run(survey_networks(config)), console)


def check_servers(config: DroneConfig, console: Console) -> bool:
    """Has each server start the drone's services, and calls them; prints what works and what not; whether all does.

    Servers are reached as in a flight: over networks that are joined where `network.kind` is "networkmanager".
    """
    if not config.servers:
        raise UsageError("no server to ask: the configuration has no [[server]] table")
    from upwash.launch.server_survey import survey_servers

    return _print(asyncio.run(survey_servers(config)), console)


def _print(findings: Sequence[Finding], console: Console) -> bool:
    table = Table(box=None, padding=(0, 2))
    table.add_column("needed")
    table.add_column("found")
    table.add_column("ready")
    for each in findings:
        table.add_row(
            Text(each.subject),
            Text(each.found),
            Text("no", style="red") if each.trouble else Text("yes", style="green"),
        )
    console.print(table)
    for each in findings:
        if each.trouble:
            console.print(Text(f"{each.subject}: {each.trouble}"), soft_wrap=True)
    return not any(each.trouble for each in findings)
