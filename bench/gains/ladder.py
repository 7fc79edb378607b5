"""The worlds, and the variants of upwash that fly in them, each with one mechanism more than the one before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
from bench.gains.kept import Missions
from bench.hedging import WAYS
from bench.hedging import world as faulty_world

from upwash.config.drone import DroneConfig
from upwash.errors import UpwashError
from upwash.lab.bounds import bound_of
from upwash.lab.campaigns.comparison import Entrant, NamedScenario, read_scenarios, thesis_scenarios
from upwash.lab.run import simulate

LADDER = (
    Entrant("local-only", "local-only"),  # the first one is what gains are counted from
    Entrant("opportunistic", "opportunistic"),
    Entrant("location-aware", "location-aware"),
    Entrant("look-ahead", "look-ahead", left_alone_s=60.0, hedges=False),
    Entrant("+ prepare", "look-ahead", left_alone_s=60.0, hedges=False, among_peers=True),
    Entrant("+ hedging", "look-ahead", left_alone_s=60.0, hedges=True, among_peers=True),
    Entrant("+ probing", "look-ahead", among_peers=True),  # its defaults
)
_SCENARIOS = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))
_CELLS = ("thesis", "thesis-battery")  # the thesis's mission, which flies as its eight cells
_FAULTS = {"none": "nothing"} | {
    name: name for name in ("answers 3 s late", "answers 8 s late", "no answer", "link lost")
}


class World(NamedTuple):
    """One world; each seed is a mission in it of its own."""

    group: str
    name: str
    config_of: Callable[[int], DroneConfig]


class Part(NamedTuple):
    """What one process does in one go: every variant's mission in one world, with one seed."""

    group: str
    world: str
    config: DroneConfig


def worlds() -> Iterator[World]:
    """All of them: the thesis's cells, the scenarios of one drone that have servers, and servers that fail."""
    for cell in thesis_scenarios():
        yield World("thesis", cell.name.removeprefix("thesis, "), partial(_seeded, cell))
    for scenario in read_scenarios(_SCENARIOS):
        config = scenario.config
        if config.mission.photos is not None:  # a drone that does not wait: bench.rows has its gains
            continue
        if config.servers and not config.drones and scenario.name not in _CELLS:
            yield World("scenarios", scenario.name, partial(_seeded, scenario))
    for name, way in _FAULTS.items():
        yield World("faulty servers", name, partial(faulty_world, way=WAYS[way], hedge=None))


def parts(flown: Sequence[World], *, seeds: int) -> list[Part]:
    """The missions to be flown, world by world."""
    return [
        Part(world.group, world.name, world.config_of(seed))
        for world in flown
        for seed in range(1, seeds + 1)
    ]


def fly(part: Part) -> Missions:
    """Flies them; the bound is of the first variant's flight, and so the same for all."""
    times_s: dict[str, float] = {}
    bound_s = 0.0
    for variant in LADDER:
        config = variant.enters(part.config)
        run = simulate(config)
        if not times_s and (bound := bound_of(run, config)):
            bound_s = bound.free_s
        if not run.result.completed or run.failure:
            raise UpwashError(f"{part.world}, {variant.name}, seed {config.seed}: {run.failure}")
        times_s[variant.name] = run.result.mission_time_s
    return Missions(part.group, part.world, part.config.seed, bound_s, times_s)


def _seeded(scenario: NamedScenario, seed: int) -> DroneConfig:
    return msgspec.structs.replace(scenario.config, seed=seed)
