"""What networks, servers and the vehicle report before take-off, printed."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config.drone import DroneConfig
from upwash.errors import UsageError
from upwash.support.sentences import say
from upwash.support.tables import show_table

if TYPE_CHECKING:
    from upwash.launch.survey import VehicleSurvey
    from upwash.real.network import SurveyFinding


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
    from upwash.launch.survey import survey_servers

    return _print(asyncio.run(survey_servers(config)), console)


def _print(findings: Sequence[SurveyFinding], console: Console) -> bool:
    table = Table("needed", "found", "ready", box=None, padding=(0, 2))
    for finding in findings:
        table.add_row(
            Text(finding.subject),
            Text(finding.found),
            Text("no", style="red") if finding.trouble else Text("yes", style="green"),
        )
    show_table(table, console)
    for finding in findings:
        if finding.trouble:
            say(Text(f"{finding.subject}: {finding.trouble}"), console)
    return not any(finding.trouble for finding in findings)


def check_vehicle(config: DroneConfig, console: Console, *, install_dead_man: bool = False) -> bool:
    """Connects to the vehicle, prints whether it and its dead man are ready; whether a flight would begin.

    `install_dead_man` installs the dead man first.
    """
    from upwash.launch.survey import survey_vehicle

    found = asyncio.run(survey_vehicle(config, install_dead_man=install_dead_man))
    wanted = config.autopilot.dead_man_s is not None
    say(Text(f"{found.vehicle} was heard on {config.autopilot.connection}"), console)
    _show_firmware(found, console)
    if found.dead_man_lacks:
        lacks = Text("dead man: ", style="red" if wanted or install_dead_man else "yellow")
        say(lacks + Text(found.dead_man_lacks), console)
    else:
        console.print(Text("dead man: ready in the autopilot", style="green"))
    if wanted:
        say(_told(config), console)
    else:
        say("autopilot.dead_man_s is not given: flights do without it", console)
    return not (found.unfit or (found.dead_man_lacks and (wanted or install_dead_man)))


def _show_firmware(found: VehicleSurvey, console: Console) -> None:
    version = found.version or "the vehicle does not tell it"
    say(Text(f"version: {version}", style="" if found.version else "yellow"), console)
    for setting in found.settings:
        value = "not known" if setting.value is None else f"{setting.value:g}"
        line = Text(f"{setting.name}: ", style="yellow") + Text(f"{value}: {setting.advice}")
        say(line, console)
    if found.unfit:
        say(Text("cannot be flown: ", style="red") + Text(found.unfit), console)


def _told(config: DroneConfig) -> str:
    settings = config.autopilot
    does = "return" if settings.on_failure == "return" else "land"
    return f"it will have the vehicle {does} once it has not heard upwash for {settings.dead_man_s:g} s in flight"
