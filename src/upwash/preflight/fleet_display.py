"""What a person sees of a check of several drones."""

from __future__ import annotations

import sys

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config import DroneConfig
from upwash.eventlog.narration import counted, spans
from upwash.preflight.check import CheckInput
from upwash.preflight.fleet import AskedServer, DroneForecast, FleetCheck, check_fleet
from upwash.preflight.prediction import AS_CONFIGURED, LOCAL_ONLY, Prediction, demanding_share, told_share
from upwash.sim.chance import plays_a_part
from upwash.support.sentences import say


def show_fleet_check(plan: CheckInput, *, seeds: int, as_json: bool, workers: int | None) -> bool:
    """Checks the file and prints what was found; returns whether there is nothing to warn of."""
    found = check_fleet(
        plan.document, plan.file, seeds=seeds if plays_a_part(plan.config) else 1, workers=workers
    )
    if as_json:
        share = demanding_share(plan.config)
        of_going = {} if share is None else {"demanding_share": share}
        printed = msgspec.to_builtins(found) | {"warnings": found.warnings} | of_going
        sys.stdout.write(msgspec.json.encode(printed).decode() + "\n")
    else:
        _print(found, plan.config, Console(markup=False))
    return not found.warnings


def _print(found: FleetCheck, config: DroneConfig, console: Console) -> None:
    say(
        f"{found.config} is understood: {counted(len(found.drones), 'drone')}, "
        f"{counted(len(config.services), 'service')}, {counted(len(config.servers), 'server')}",
        console,
    )
    console.print()
    console.print(_table(found.drones))
    if share := told_share(config):
        say(share, console)
    console.print()
    for each in found.drones:
        if each.order:
            say(Text(f"order of {each.drone}'s waypoints: {each.order}"), console)
    for server in found.servers:
        say(_asked_line(server, len(found.drones)), console)
    for notice in found.notices:
        say(Text("notice: ", style="cyan") + Text(notice), console)
    for warning in found.warnings:
        say(Text("warning: ", style="yellow") + Text(warning.text), console)
    if not found.warnings:
        console.print(Text("nothing to warn of", style="green"))


def _table(drones: tuple[DroneForecast, ...]) -> Table:
    table = Table(box=None, padding=(0, 1))
    table.add_column("drone", overflow="fold", min_width=8)
    for title in ("waypoints", LOCAL_ONLY, AS_CONFIGURED):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("out of range", overflow="fold", min_width=8)
    for each in drones:
        by_case = {prediction.case: prediction for prediction in each.predictions}
        table.add_row(
            Text(each.drone),
            str(each.waypoints),
            _time(by_case[LOCAL_ONLY]),
            _time(by_case.get(AS_CONFIGURED)),
            spans(each.uncovered),
        )
    return table


def _time(prediction: Prediction | None) -> str:
    if prediction is None:
        return "-"
    if prediction.mission_time_s is None:
        return "not completed" if prediction.failures else "vanishes"
    margin = f" ± {prediction.margin_s / 60:.2f}" if prediction.margin_s is not None else ""
    return f"{prediction.mission_time_s / 60:.2f}{margin} min"


def _asked_line(server: AskedServer, drones: int) -> str:
    return (
        f"{server.server}: in range of {server.in_range_of} of {counted(drones, 'drone')}, asked for a slot by "
        f"{server.asked_by}"
    )
