"""upwash whatif: predicts what flights would have been like under other policies, from their logs."""

from __future__ import annotations

import argparse

import msgspec
from rich.console import Console
from rich.table import Table

from upwash.cli.arguments import option, reads, repeated
from upwash.core.policies.names import POLICIES
from upwash.eventlog.log import EventLog
from upwash.lab.whatif import DRAWS, Replays, Tuned, Tuning, WhatIf, order_of, tune, what_if
from upwash.report.reviews import logs_among
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, lasting, printable

ARGUMENTS = {
    "logs LOG": reads("event logs of flights, flown or simulated", nargs="+"),
    "--policy NAME": repeated(
        "predict these policies; your own as mine.py:Class (default: all built in)", "policies"
    ),
    "--tune": "say what other settings of the policy would have gained in the flights",
    "--draws N": option(f"replays of each policy (default: {DRAWS})", default=DRAWS),
    "--json": "print one JSON object",
    "--workers N": "processes (default: one per core)",
}


def run(options: argparse.Namespace) -> None:
    """Replay them with a progress bar, and print what is predicted."""
    options.logs = logs_among(options.logs)
    logs = [EventLog(log) for log in options.logs]
    policies = options.policies or list(POLICIES)
    with work("replays") as replayed:
        replays = Replays(max(3, options.draws), options.workers, replayed)
        if options.tune:
            tuning = tune(logs, next(iter(options.policies), None), replays=replays)
        else:
            flights = {str(log): what_if(EventLog(log), policies, replays=replays) for log in options.logs}
    console = Console(markup=False, highlight=False)
    if options.json:
        facts = {"tuning": tuning} if options.tune else {"flights": flights}
        print(msgspec.json.format(msgspec.json.encode(facts)).decode())
    elif options.tune:
        _show_tuning(tuning, len(logs), console)
    else:
        for log, found in flights.items():
            _show(log, found, console)


def _show(log: str, found: WhatIf, console: Console) -> None:
    ran = f"{counted(found.calls, 'call')}, {found.remote_calls} of them on servers"
    say(f"{printable(log)}: flown in {lasting(found.flown_s)} under {found.policy}; {ran}", console)
    for note in found.notes:
        say(f"note: {printable(note)}", console)
    table = Table(box=None, padding=(0, 1))
    for title in ("predicted", "mission time", "95 % interval", "against the flight"):
        table.add_column(title, justify="left" if title == "predicted" else "right", no_wrap=True)
    for one in found.predictions:
        flown = " (flown)" if one.policy == found.policy else ""
        share = one.time_s / found.flown_s - 1
        table.add_row(
            f"{one.policy}{flown}",
            lasting(one.time_s),
            f"{lasting(one.low_s)} to {lasting(one.high_s)}",
            f"{100 * share:+.1f} %",
        )
    if found.predictions:
        show_table(table, console)
    for policy, why in found.refused.items():
        say(f"{policy}: not predicted: {why}", console)
    for line in order_of(found.predictions) if len(found.predictions) > 1 else ():
        say(line, console)
    if len(found.predictions) > 1 and not any(order_of(found.predictions)):
        say("all intervals overlap: none is quicker for sure", console)


def _show_tuning(found: Tuning, flights: int, console: Console) -> None:
    say(
        f"{counted(flights, 'flight')} of {lasting(found.flown_s)} together, under {found.policy}",
        console,
    )
    table = Table(box=None, padding=(0, 1))
    table.add_column("setting", no_wrap=True)
    table.add_column("would have saved", justify="right", no_wrap=True)
    for one in found.settings:
        table.add_row(one.setting, _saving(one, found))
    show_table(table, console)
    if found.best is None:
        say(
            "no setting saves more than its margin in the first half of the replays: keep what you have",
            console,
        )
    else:
        said = f"best in one half of the replays: {found.best.setting}; in the other half it saves"
        say(f"{said} {_saving(found.best, found)}", console)
    for line in found.estimates:
        say(f"measured at {printable(line)}", console)


def _saving(one: Tuned, found: Tuning) -> str:
    share = 100 * one.saved.value / found.flown_s
    return f"{one.saved.value:.1f} ± {one.saved.margin:.1f} s ({share:.1f} %)"
