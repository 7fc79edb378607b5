"""Servers reserved before the flight, beside drones that take turns in flight.

A planner that knows every plan simulates the fleet without noise. It gives each server to one drone at a time: to the
drone in range that has had the least time. It repeats that with the flights that follow, with slots of several
lengths, and keeps the table with the shortest mean mission. In flight, with noise, a drone uses a server only at the
drone's own times.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from statistics import fmean
from typing import NamedTuple

from bench.sharing import crossing_routes, replaced, same_field
from msgspec import Struct

from upwash.config.drone import DroneConfig, PolicyConfig
from upwash.config.drone_file import fleet_of
from upwash.config.world import NoiseConfig
from upwash.lab.outcome import jain
from upwash.lab.run import Run, simulate_fleet
from upwash.policies import Choice, LocationAware, Situation
from upwash.support.confidence import Mean, mean_of

SLOTS_S, ROUNDS = (60.0, 150.0, 400.0), 3
FLEETS, QUICK_FLEETS = (2, 4, 8), (2,)
LAYOUTS: Mapping[str, Callable[[int], DroneConfig]] = {
    "same field, 2 servers": same_field,
    "crossing routes, 4 servers": crossing_routes,
}
NOISE = NoiseConfig(call=0.03, leg=0.02)
WAYS = ("local-only", "opportunistic", "first come", "reserved", "turns", "turns, auto")
Times = Mapping[str, Sequence[tuple[float, float]]]  # from and to, in seconds, by server


class Reserved(LocationAware):
    """The fastest of the servers in range that are the drone's at the time."""

    times: Mapping[str, Sequence[Sequence[float]]]

    def __init__(self, *, times: Mapping[str, Sequence[Sequence[float]]]) -> None:
        super().__init__()
        object.__setattr__(self, "times", times)

    def choose(self, situation: Situation) -> Choice:
        """As location-aware among them."""
        now_s, times = situation.now_s, self.times
        own = [
            option
            for option in situation.options
            if any(from_s <= now_s < to_s for from_s, to_s in times.get(option.server, ()))
        ]
        current = situation.current if situation.current in {option.server for option in own} else None
        return super().choose(replaced(situation, options=own, current=current))


class Fleet(NamedTuple):
    """A fleet to fly in each of the WAYS."""

    layout: str
    drones: int
    seed: int


class Shared(Struct, frozen=True, kw_only=True):
    """What one way of sharing gives a fleet: missions, savings against local-only, and Jain's index of these."""

    layout: str
    drones: int
    way: str
    mean_min: float
    saved_percent: float
    margin_percent: float
    worst_min: float
    jain: float


def fly(fleet: Fleet) -> tuple[Fleet, dict[str, list[float]]]:
    """The times (s) of the drones' missions, by way."""
    config = replaced(LAYOUTS[fleet.layout](fleet.drones), seed=fleet.seed, noise=NOISE)
    one, auto = _with_slots(config, 1, math.inf), _with_slots(config, "auto", 30.0)
    ways = {
        "local-only": _under(one, "local-only"),
        "opportunistic": _under(one, "opportunistic"),
        "first come": _under(one, "look-ahead"),
        "reserved": _reserving(one, planned(fleet.layout, fleet.drones)),
        "turns": _under(_with_slots(config, 1, 30.0), "look-ahead"),
        "turns, auto": _under(auto, "look-ahead"),
    }
    return fleet, {way: _times_s(simulate_fleet(drones)) for way, drones in ways.items()}


def rows(flown: Mapping[Fleet, Mapping[str, Sequence[float]]]) -> Iterator[Shared]:
    """What each way gives, over the seeds of each fleet."""
    groups: dict[tuple[str, int], list[Mapping[str, Sequence[float]]]] = defaultdict(list)
    for fleet, ways in flown.items():
        groups[fleet.layout, fleet.drones].append(ways)
    for (layout, drones), seeds in groups.items():
        for way in WAYS:
            saved: Mean = mean_of(
                [100 * (1 - fmean(ways[way]) / fmean(ways["local-only"])) for ways in seeds]
            )
            even = [
                jain(own - time for own, time in zip(ways["local-only"], ways[way], strict=True)) or 1.0
                for ways in seeds
            ]
            yield Shared(
                layout=layout,
                drones=drones,
                way=way,
                mean_min=fmean(fmean(ways[way]) for ways in seeds) / 60,
                saved_percent=saved.value,
                margin_percent=saved.margin,
                worst_min=fmean(max(ways[way]) for ways in seeds) / 60,
                jain=fmean(even),
            )


@cache
def planned(layout: str, drones: int) -> list[Times]:
    """The times of each drone at each server, made before the flight."""
    calm = _with_slots(LAYOUTS[layout](drones), 1, math.inf)
    best: list[Times] = [{} for _ in range(drones)]
    best_s = math.inf
    for slot_s in SLOTS_S:
        runs = simulate_fleet(_under(calm, "local-only"))
        for _ in range(ROUNDS):
            table = _table(runs, slot_s)
            runs = simulate_fleet(_reserving(calm, table))
            if (mean_s := fmean(_times_s(runs))) < best_s:
                best, best_s = table, mean_s
    return best


def _table(runs: Sequence[Run], slot_s: float) -> list[Times]:
    """Each server's slots of time, each for the drone in range then that has the least of them."""
    stays = [
        (number, stay.server, stay.from_s, stay.to_s)
        for number, run in enumerate(runs)
        for stay in run.range_intervals
    ]
    table: list[dict[str, list[tuple[float, float]]]] = [{} for _ in runs]
    given = [0 for _ in runs]
    servers = sorted({server for _, server, _, _ in stays})
    for slot in range(int(max((min(to_s, 36000.0) for *_, to_s in stays), default=0.0) / slot_s) + 1):
        from_s, to_s = slot * slot_s, (slot + 1) * slot_s
        taken: set[int] = set()
        for server in servers:
            there = {
                number
                for number, at, since_s, until_s in stays
                if at == server and min(to_s, until_s) - max(from_s, since_s) > slot_s / 2
            }
            if free := there - taken:
                number = min(free, key=lambda each: (given[each], each))
                taken.add(number)
                given[number] += 1
                table[number].setdefault(server, []).append((from_s, to_s))
    return list(table)


def _under(config: DroneConfig, policy: str) -> list[DroneConfig]:
    return [replaced(drone, policy=PolicyConfig(name=policy)) for drone in fleet_of(config)]


def _reserving(config: DroneConfig, table: Sequence[Times]) -> list[DroneConfig]:
    name = f"{Reserved.__module__}:{Reserved.__qualname__}"
    return [
        replaced(drone, policy=PolicyConfig(name=name, settings={"times": times}))  # type: ignore[dict-item]
        for drone, times in zip(fleet_of(config), table, strict=True)
    ]


def _with_slots(config: DroneConfig, slots: int | str, turn_s: float) -> DroneConfig:
    servers = tuple(
        replaced(server, truth=replaced(server.truth, slots=slots, turn_s=turn_s))
        for server in config.servers
    )
    return replaced(config, servers=servers)


def _times_s(runs: Sequence[Run]) -> list[float]:
    assert all(run.result.completed for run in runs)
    return [run.result.mission_time_s for run in runs]
