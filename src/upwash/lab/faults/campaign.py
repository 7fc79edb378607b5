"""Flies worlds full of faults, and tests the promises over what they leave behind."""

from __future__ import annotations

import dataclasses
import functools
import math
import traceback
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from upwash.config.drone import DroneConfig
from upwash.config.reading import Document
from upwash.lab.faults.promises import Broken, History, Promise, broken_promises
from upwash.lab.faults.worlds import SEEDS_PER_SCENARIO, World, configs, moment_of
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate_fleet

_NEVER_S = 1e6


@dataclass(frozen=True, slots=True)
class ChaosFlight:
    """A world that was flown: the drones' scenarios with their faults, what became of them, what an observer saw."""

    documents: list[Document]
    runs: list[Run]
    seen: list[Observation]
    broken: list[Broken]


@dataclass(frozen=True, slots=True)
class WorldVerdict:
    """The result of one world, with its longest call and that call's bound, and the least margin of any call."""

    seed: int
    broken: list[Broken]
    drones: int
    calls: int
    longest_s: tuple[float, float]
    spare_s: float


def judge(seed: int, *, replay: bool = False) -> WorldVerdict:
    """Flies the world of the seed and tests its promises; with `replay` twice, which must leave the same log."""
    try:
        flown = fly_world(seed)
        broken = flown.broken or (_differences(seed, flown) if replay else [])
    except Exception as error:  # noqa: BLE001 - whatever breaks out of a simulation breaks the first promise
        why = "".join(traceback.format_exception(error))
        return WorldVerdict(seed, [Broken(Promise.AUTONOMY, seed, None, why)], 0, 0, (0.0, 0.0), math.inf)
    bounds_s = [
        (call.ended.delay_s, call.bound_s)
        for history in map(History, configs(flown.documents), flown.runs)
        if not history.asks_servers  # else calls have the bound that the mission chose
        for call in history.calls
    ]
    return WorldVerdict(
        seed,
        broken,
        drones=len(flown.runs),
        calls=sum(len(run.result.calls) for run in flown.runs),
        longest_s=max(bounds_s, default=(0.0, 0.0)),
        spare_s=min((bound_s - delay_s for delay_s, bound_s in bounds_s), default=math.inf),
    )


def fly_world(seed: int) -> ChaosFlight:
    """The world of the seed, flown with its faults; without them where that breaks a promise already."""
    calm = _fly_calm((seed - 1) // SEEDS_PER_SCENARIO)
    if calm.broken:
        return dataclasses.replace(
            calm, broken=[dataclasses.replace(breach, seed=seed) for breach in calm.broken]
        )
    moments = [*map(moment_of, calm.seen), *(moment_of(event) for run in calm.runs for event in run.events)]
    documents = World(seed).faulty(seed, moments)
    return _fly(seed, documents, calm.alone)


@dataclass(frozen=True, slots=True)
class _Calm(ChaosFlight):
    alone: list[Run]


@functools.lru_cache(maxsize=1)
def _fly_calm(number: int) -> _Calm:
    seed = number * SEEDS_PER_SCENARIO + 1
    documents = World(seed).calm()
    alone = [_alone(config) for config in configs(documents)]
    flown = _fly(seed, documents, alone)
    return _Calm(documents, flown.runs, flown.seen, flown.broken, alone)


def _alone(config: DroneConfig) -> Run:
    policy = msgspec.structs.replace(config.policy, period_s=_NEVER_S)
    by_itself = msgspec.structs.replace(config, servers=(), faults=(), policy=policy)
    return simulate_fleet([by_itself], computing=True)[0]


def _fly(seed: int, documents: list[Document], alone: Sequence[Run]) -> ChaosFlight:
    fleet, seen = configs(documents), list[Observation]()
    runs = simulate_fleet(fleet, computing=True, seen=seen)
    broken: list[Broken] = []
    for config, run, by_itself in zip(fleet, runs, alone, strict=True):
        delayed = any(fault.target == "autopilot" for fault in config.faults)
        history = History(config, run, seen, None if delayed else by_itself)
        broken += broken_promises(history, seed=seed)
    return ChaosFlight(documents, runs, seen, broken)


def _differences(seed: int, first: ChaosFlight) -> list[Broken]:
    runs = simulate_fleet(configs(first.documents), computing=True, seen=[])
    for one, other in zip(first.runs, runs, strict=True):
        for event, again in zip(one.events, other.events, strict=False):
            if event != again:
                why = f"flown again it was {again}"
                return [Broken(Promise.REPRODUCIBLE, seed, msgspec.to_builtins(event), why)]
        if one.log() != other.log():
            return [Broken(Promise.REPRODUCIBLE, seed, None, "flown again the log has another length")]
    return []
