"""What hedging does where a third of the servers are faulty: `python -m bench.hedging`.

A survey of 9 x 9 photos over nine servers with a cell each, 30 seeds, 3 % noise on calls and 2 % on legs. Three
servers are faulty for 30 s in every 90 s, with one kind of fault after another; the drone's estimates are all alike.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from statistics import fmean, quantiles

import msgspec
from bench.program import command_line

from upwash.config.drone import (
    DroneConfig,
    GridConfig,
    MissionConfig,
    PolicyConfig,
    ServerConfig,
    ServiceConfig,
)
from upwash.config.world import FaultConfig, NoiseConfig
from upwash.core.selection.hedging import HedgeRule
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate

SEEDS = 30
HEDGES = {"without": None, "with": HedgeRule()}
WAYS: dict[str, FaultConfig | None] = {
    "nothing": None,
    "answers 3 s late": FaultConfig(target="", kind="slow", extra_s=3.0),
    "answers 5 s late": FaultConfig(target="", kind="slow", extra_s=5.0),
    "answers 8 s late": FaultConfig(target="", kind="slow", extra_s=8.0),
    "no answer": FaultConfig(target="", kind="stuck"),
    "link silent": FaultConfig(target="link:", kind="stuck"),
    "link lost": FaultConfig(target="link:", kind="off"),
}
QUICK_WAYS = ["nothing", "no answer"]
PERIOD_S, SPELL_S, LONGEST_S = 90.0, 30.0, 3600.0


def main() -> None:
    """Flies and prints."""
    quick = command_line("hedging", __doc__).parse_args().quick
    ways, seeds = (QUICK_WAYS, 1) if quick else (list(WAYS), SEEDS)
    print("| wrong | hedging | p50 s | p99 s | longest s | mission min | hedged calls | local calls |")
    print("|---|---|---|---|---|---|---|---|")
    for what in ways:
        for hedging, hedge in HEDGES.items():
            runs = [simulate(world(seed, WAYS[what], hedge)) for seed in range(seeds)]
            print(f"| {what} | {hedging} | {line(runs)} |", flush=True)


def world(seed: int, way: FaultConfig | None, hedge: HedgeRule | None) -> DroneConfig:
    """The survey with a third of its servers faulty in that way, and hedging."""
    chance = random.Random(seed)
    names = [f"s{number}" for number in range(9)]
    return DroneConfig(
        seed=seed,
        mission=MissionConfig(grid=GridConfig(columns=9, rows=9, spacing_m=20.0)),
        policy=PolicyConfig(name="location-aware", hedge=hedge),
        services=(ServiceConfig(name="detector", local_call_s={"light": 3.0, "heavy": 10.0}),),
        servers=tuple(server(name, number) for number, name in enumerate(names)),
        noise=NoiseConfig(call=0.03, leg=0.02),
        faults=tuple(
            fault
            for name in chance.sample(names, 3)
            for fault in spells(name, way, chance.uniform(0, PERIOD_S))
        ),
    )


def server(name: str, number: int) -> ServerConfig:
    """One of nine, three in a row; their ranges overlap a little."""
    return ServerConfig(
        name=name,
        east_m=20.0 + 60.0 * (number % 3),
        north_m=20.0 + 60.0 * (number // 3),
        range_m=45.0,
        network=name,
        remote_call_s={"detector": {"light": 0.3, "heavy": 0.7}},
    )


def spells(name: str, way: FaultConfig | None, first_s: float) -> list[FaultConfig]:
    """The times of one kind of fault of the server."""
    if way is None:
        return []
    starts_s = [first_s + number * PERIOD_S for number in range(int(LONGEST_S / PERIOD_S))]
    return [
        msgspec.structs.replace(way, target=way.target + name, from_s=start_s, to_s=start_s + SPELL_S)
        for start_s in starts_s
    ]


def line(runs: Sequence[Run]) -> str:
    """The results of the flights."""
    delays_s = [call.delay_s for run in runs for call in run.result.calls]
    events = [event for run in runs for event in run.events]
    hedged = sum(isinstance(event, schema.Hedged) for event in events)
    local = sum(run.result.totals.local for run in runs)
    cuts_s = quantiles(delays_s, n=100)
    return (
        f"{cuts_s[49]:.2f} | {cuts_s[98]:.2f} | {max(delays_s):.2f} | "
        f"{fmean(run.result.mission_time_s for run in runs) / 60:.2f} | {hedged} | {local} of {len(delays_s)}"
    )


if __name__ == "__main__":
    main()
