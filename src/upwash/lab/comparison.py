"""Every policy in the same worlds: how long its missions take, beside what an all-knowing drone would need."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import msgspec

from upwash.config import DroneConfig, NoiseConfig, ServerConfig
from upwash.core.policies import POLICIES
from upwash.errors import UpwashError
from upwash.lab import processes
from upwash.lab.bounds import bound_of
from upwash.lab.confidence import Mean, mean_of
from upwash.lab.reproduction import EXPERIMENTS, SETUPS, Cell, scenario
from upwash.lab.run import simulate
from upwash.lab.simulation import read_scenario, with_policy

_NOISE = NoiseConfig(
    call=0.03, leg=0.02
)  # of a scenario without any: without it all seeds are the same mission


class World(NamedTuple):
    """A scenario by its name in the comparison."""

    name: str
    config: DroneConfig


class Entrant(NamedTuple):
    """A policy that is compared, by its name in the comparison, and what it is given besides."""

    name: str
    policy: str
    left_alone_s: float | None = None  # after a failure, and nothing is hedged
    among_peers: bool = False  # every server is a peer of every other

    def enters(self, config: DroneConfig) -> DroneConfig:
        """The scenario as it flies there."""
        replace = msgspec.structs.replace
        config = with_policy(config, self.policy)
        if self.among_peers:
            config = replace(config, servers=_all_peers(config.servers))
        if self.left_alone_s is None:
            return config
        policy = replace(config.policy, blacklist_s=self.left_alone_s, probe=None, hedge=False)
        return replace(config, policy=policy)


ENTRANTS = (
    *(Entrant(policy, policy) for policy in POLICIES),
    Entrant("look-ahead, prepare", "look-ahead", among_peers=True),
    Entrant("look-ahead, left alone", "look-ahead", left_alone_s=60.0),
)


class Flight(NamedTuple):
    """One mission to be flown."""

    world: World
    entrant: Entrant
    seed: int


class Flown(NamedTuple):
    """What one mission came to."""

    world: str
    entrant: str
    mission_time_s: float
    bound_s: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """The mean mission times of one world by entrant, and the bound."""

    world: str
    bound_s: float
    mission_time_s: Mapping[str, Mean]


def scenario_worlds(files: Sequence[Path]) -> list[World]:
    """The worlds of scenario files, with some noise where they have none."""
    worlds = [World(file.stem, read_scenario(file)) for file in files]
    return [
        World(
            name, msgspec.structs.replace(config, noise=_NOISE) if config.noise == NoiseConfig() else config
        )
        for name, config in worlds
    ]


def thesis_worlds() -> list[World]:
    """The eight cells of the thesis's experiments."""
    return [
        World(
            f"thesis, {experiment.name}, {setup}", scenario(Cell(setup, experiment, "location-aware"), seed=1)
        )
        for setup, experiment in product(SETUPS, EXPERIMENTS)
    ]


def compare(
    worlds: Sequence[World],
    *,
    seeds: int,
    workers: int | None = None,
    flown: Callable[[], None] = lambda: None,
) -> list[Comparison]:
    """Flies every entrant in every world with the seeds 1 to `seeds`, and tells `flown` of each mission."""
    flights = [Flight(*each) for each in product(worlds, ENTRANTS, range(1, seeds + 1))]
    missions: list[Flown] = []
    with processes.in_processes(_fly, flights, workers=workers) as results:
        for mission in results:
            missions.append(mission)
            flown()
    return [_comparison(world.name, missions) for world in worlds]


def show_comparison(files: Sequence[Path], *, thesis: bool, seeds: int, workers: int | None = None) -> None:
    """Compares with a progress bar, and prints a Markdown table in minutes."""
    from rich.console import Console
    from rich.progress import Progress

    worlds = [*(thesis_worlds() if thesis else []), *scenario_worlds(files)]
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("missions", total=len(worlds) * len(ENTRANTS) * seeds)
        comparisons = compare(worlds, seeds=seeds, workers=workers, flown=lambda: bar.advance(task))
    Console(markup=False).print("\n".join(_lines(comparisons)), soft_wrap=True, highlight=False)


def _fly(flight: Flight) -> Flown:
    config = msgspec.structs.replace(flight.entrant.enters(flight.world.config), seed=flight.seed)
    run = simulate(config)
    bound = bound_of(run, config)
    if bound is None:
        raise UpwashError(f"{flight.world.name}, {flight.entrant.name}, seed {flight.seed}: {run.failure}")
    return Flown(flight.world.name, flight.entrant.name, run.result.mission_time_s, bound.free_s)


def _all_peers(servers: Sequence[ServerConfig]) -> tuple[ServerConfig, ...]:
    replace = msgspec.structs.replace
    return tuple(
        replace(
            server,
            truth=replace(
                server.truth, peers=tuple(other.name for other in servers if other.name != server.name)
            ),
        )
        for server in servers
    )


def _comparison(world: str, missions: Sequence[Flown]) -> Comparison:
    own = [mission for mission in missions if mission.world == world]
    times_s = {
        entrant.name: mean_of(sorted(each.mission_time_s for each in own if each.entrant == entrant.name))
        for entrant in ENTRANTS
    }
    return Comparison(world, fmean(sorted(mission.bound_s for mission in own)), times_s)


def _lines(comparisons: Sequence[Comparison]) -> Iterator[str]:
    yield f"| minutes | bound | {' | '.join(entrant.name for entrant in ENTRANTS)} |"
    yield f"|---|---|{'---|' * len(ENTRANTS)}"
    for each in comparisons:
        cells = [_cell(each.mission_time_s[entrant.name], each.bound_s) for entrant in ENTRANTS]
        yield f"| {each.world} | {each.bound_s / 60:.2f} | {' | '.join(cells)} |"


def _cell(mean: Mean, bound_s: float) -> str:
    margin = f" ± {mean.margin / 60:.2f}" if mean.count > 1 else ""
    return f"{mean.value / 60:.2f}{margin} ({100 * (mean.value / bound_s - 1):+.1f} %)"
