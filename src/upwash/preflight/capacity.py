"""How many drones the servers of a configuration carry: its mission, flown by more and more drones at the same time.

All fly the same way over the same field, and set off within a minute, one after the other. This is the hardest case
for servers: they are needed at the same places, and so at the same time.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import msgspec
from msgspec import Struct
from rich.console import Console
from rich.table import Table

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import Presence
from upwash.errors import UpwashError, UsageError
from upwash.lab.run import Run, simulate_fleet
from upwash.lab.scenario import with_policy
from upwash.preflight.prediction import LOCAL_ONLY
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, lasting

SLOWER = 1.05  # the most that the mean time may grow for drones that are carried
_NUMBERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
_WITHIN_S = 60.0
_WORTH = 0.5  # of what one drone alone saves: with less, more drones are not asked for


class FleetLoad(Struct, frozen=True, kw_only=True):
    """A number of drones at once: the times of their missions, and how many of their calls ran on servers."""

    drones: int
    mean_s: float
    worst_s: float
    saved: float
    remote_share: float
    calls_per_min: Mapping[str, float]


class Capacity(Struct, frozen=True, kw_only=True):
    """What was found; `carried` drones are the most of those tried whose missions take hardly longer than one's."""

    config: str
    local_only_s: float
    loads: tuple[FleetLoad, ...]
    carried: int


def capacity_of(
    config: DroneConfig, name: str, flown: Callable[[FleetLoad], None] = lambda _: None
) -> Capacity:
    """Flies the mission of a configuration of one drone; raises UsageError where nothing is offloaded."""
    if config.drones:
        raise UsageError("capacity is measured with one drone's mission, and this file has [[drone]] tables")
    if config.policy.name == LOCAL_ONLY or not config.servers:
        raise UsageError("every call runs on the drone: name servers, and another policy than local-only")
    (alone,) = simulate_fleet([with_policy(config, LOCAL_ONLY)])
    local_only_s = _completed([alone])[0].result.mission_time_s
    loads: list[FleetLoad] = []
    for load in _loads(config, local_only_s):
        loads.append(load)
        flown(load)
    carried = max((load.drones for load in loads if load.mean_s <= SLOWER * loads[0].mean_s), default=1)
    return Capacity(config=name, local_only_s=local_only_s, loads=tuple(loads), carried=carried)


def _loads(config: DroneConfig, local_only_s: float) -> Iterator[FleetLoad]:
    """More and more drones, while they save enough."""
    first: FleetLoad | None = None
    for drones in _NUMBERS:
        load = _load(config, drones, local_only_s)
        yield load
        first = first or load
        if load.saved < _WORTH * first.saved:
            return


def _load(config: DroneConfig, drones: int, local_only_s: float) -> FleetLoad:
    fleet = [
        msgspec.structs.replace(config, name=f"{config.name}-{number}", seed=config.seed + number)
        for number in range(drones)
    ]
    departs_s = [_WITHIN_S * number / drones for number in range(drones)]
    runs = _completed(simulate_fleet(fleet, there=[Presence(each_s) for each_s in departs_s]))
    times_s = [run.result.mission_time_s for run in runs]
    remote = Counter[str]()
    for run in runs:
        remote.update(run.result.totals.remote)
    lasted_s = max(begun_s + time_s for begun_s, time_s in zip(departs_s, times_s, strict=True))
    mean_s = sum(times_s) / drones
    return FleetLoad(
        drones=drones,
        mean_s=mean_s,
        worst_s=max(times_s),
        saved=1 - mean_s / local_only_s,
        remote_share=remote.total() / sum(run.result.totals.calls for run in runs),
        calls_per_min={server.name: 60 * remote[server.name] / lasted_s for server in config.servers},
    )


def _completed(runs: list[Run]) -> list[Run]:
    for run in runs:
        if run.failure:
            raise UpwashError(f"the mission is not completed in simulation: {run.failure}")
    return runs


def show_capacity(config: DroneConfig, name: str, *, as_json: bool) -> bool:
    """Flies it with more and more drones and prints what came of it; returns whether the servers carry any."""
    with work("fleets flown in simulation, each with more drones") as flown:
        found = capacity_of(config, name, lambda _: flown())
    if as_json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _print(found, Console(markup=False))
    return found.loads[0].saved > 0


def _print(found: Capacity, console: Console) -> None:
    say(
        f"{found.config}: the same mission flown by several drones at once, all under way within a minute; with "
        f"every call on the drone it takes {lasting(found.local_only_s)}",
        console,
    )
    console.print()
    show_table(_table(found), console)
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
            lasting(load.mean_s),
            lasting(load.worst_s),
            f"{100 * load.saved:.0f} %",
            f"{100 * load.remote_share:.0f} %",
            ", ".join(f"{server} {load.calls_per_min[server]:.0f}" for server in servers),
        )
    return table
