"""What a person sees of the capacity of a configuration's servers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

import msgspec
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table

from upwash.config import DroneConfig
from upwash.eventlog.narration import counted
from upwash.preflight.capacity import SLOWER, Capacity, Load, capacity_of
from upwash.support.sentences import say


def show_capacity(config: DroneConfig, name: str, *, as_json: bool) -> bool:
    """Flies it with more and more drones and prints what came of it; returns whether the servers carry any."""
    with _progress() as flown:
        found = capacity_of(config, name, flown)
    if as_json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _print(found, Console(markup=False))
    return found.loads[0].saved > 0


@contextmanager
def _progress() -> Generator[Callable[[Load], None]]:
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("flying it with 1 drone", total=None)
        yield lambda load: progress.update(
            task, description=f"flown with {counted(load.drones, 'drone')}, now with more"
        )


def _print(found: Capacity, console: Console) -> None:
    say(
        f"{found.config}: the same mission flown by several drones at once, all under way within a minute; with "
        f"every call on the drone it takes {found.local_only_s / 60:.1f} min",
        console,
    )
    console.print()
    console.print(_table(found))
    last = found.loads[-1]
    more = "" if last.drones > found.carried else "; more were not tried"
    console.print()
    say(
        f"the servers carry {counted(found.carried, 'drone')}: on average a mission takes at most "
        f"{100 * (SLOWER - 1):.0f} % longer than one alone{more}",
        console,
    )


def _table(found: Capacity) -> Table:
    table = Table(box=None, padding=(0, 2))
    servers = list(found.loads[0].calls_per_min)
    for title in ("drones", "mean", "worst", "saved", "calls on servers"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("a minute", overflow="fold")
    for load in found.loads:
        table.add_row(
            str(load.drones),
            f"{load.mean_s / 60:.1f} min",
            f"{load.worst_s / 60:.1f} min",
            f"{100 * load.saved:.0f} %",
            f"{100 * load.remote_share:.0f} %",
            ", ".join(f"{server} {load.calls_per_min[server]:.0f}" for server in servers),
        )
    return table
