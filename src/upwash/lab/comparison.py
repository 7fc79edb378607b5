"""Every policy in the same worlds: how long its missions take, beside what an all-knowing drone would need."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import msgspec

from upwash.config import DroneConfig, NoiseConfig
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


class Flight(NamedTuple):
    """One mission to be flown."""

    world: World
    policy: str
    seed: int


class Flown(NamedTuple):
    """What one mission came to."""

    world: str
    policy: str
    mission_time_s: float
    bound_s: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """The mean mission times of one world by policy, and the bound."""

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
    """Flies every policy in every world with the seeds 1 to `seeds`, and tells `flown` of each mission."""
    flights = [Flight(*each) for each in product(worlds, POLICIES, range(1, seeds + 1))]
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
        task = bar.add_task("missions", total=len(worlds) * len(POLICIES) * seeds)
        comparisons = compare(worlds, seeds=seeds, workers=workers, flown=lambda: bar.advance(task))
    Console(markup=False).print("\n".join(_lines(comparisons)), soft_wrap=True, highlight=False)


def _fly(flight: Flight) -> Flown:
    config = msgspec.structs.replace(with_policy(flight.world.config, flight.policy), seed=flight.seed)
    run = simulate(config)
    bound = bound_of(run, config)
    if bound is None:
        raise UpwashError(f"{flight.world.name}, {flight.policy}, seed {flight.seed}: {run.failure}")
    return Flown(flight.world.name, flight.policy, run.result.mission_time_s, bound.free_s)


def _comparison(world: str, missions: Sequence[Flown]) -> Comparison:
    own = [mission for mission in missions if mission.world == world]
    times_s = {
        policy: mean_of(sorted(each.mission_time_s for each in own if each.policy == policy))
        for policy in POLICIES
    }
    return Comparison(world, fmean(sorted(mission.bound_s for mission in own)), times_s)


def _lines(comparisons: Sequence[Comparison]) -> Iterator[str]:
    yield f"| minutes | bound | {' | '.join(POLICIES)} |"
    yield f"|---|---|{'---|' * len(POLICIES)}"
    for each in comparisons:
        cells = [_cell(each.mission_time_s[policy], each.bound_s) for policy in POLICIES]
        yield f"| {each.world} | {each.bound_s / 60:.2f} | {' | '.join(cells)} |"


def _cell(mean: Mean, bound_s: float) -> str:
    margin = f" ± {mean.margin / 60:.2f}" if mean.count > 1 else ""
    return f"{mean.value / 60:.2f}{margin} ({100 * (mean.value / bound_s - 1):+.1f} %)"
