"""What patience with a first call is worth: `python -m bench.first_call [SEEDS]`.

Every scenario and the thesis's eight cells under `look-ahead` and `location-aware`, with and without
`patient_first_call`, where a service's first call on a server takes as long as the others, 0.5, 2 or 5 s longer.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from statistics import fmean

import msgspec

from upwash.config import DroneConfig
from upwash.lab.comparison import World, scenario_worlds, thesis_worlds
from upwash.lab.confidence import mean_of
from upwash.lab.run import simulate
from upwash.lab.simulation import with_policy

POLICIES = ("look-ahead", "location-aware")
EXTRAS_S = (0.0, 0.5, 2.0, 5.0)
SCENARIOS = sorted(Path("scenarios").glob("*.toml"))


def main(seeds: int = 30) -> None:
    """Flies and prints minutes without patience, and what it changes, paired by seed, ± 95 %."""
    print("| policy | first call | world | without | changes by | |")
    print("|---|---|---|---|---|---|")
    for policy, extra_s, world in product(
        POLICIES, EXTRAS_S, (*thesis_worlds(), *scenario_worlds(SCENARIOS))
    ):
        without_min, changes_min = zip(*flown(world, policy, extra_s, seeds), strict=True)
        mean, change = fmean(without_min), mean_of(changes_min)
        print(
            f"| {policy} | +{extra_s:g} s | {world.name} | {mean:.2f} | {change.value:+.2f} ± {change.margin:.2f} "
            f"| {100 * change.value / mean:+.1f} % |",
            flush=True,
        )


def flown(world: World, policy: str, extra_s: float, seeds: int) -> Iterator[tuple[float, float]]:
    """Minutes of each seed's mission without patience, and how many more or less with it."""
    config = with_policy(slow_at_first(world.config, extra_s), policy)
    for seed in range(1, seeds + 1):
        without, patient = (
            simulate(
                msgspec.structs.replace(
                    config,
                    seed=seed,
                    policy=msgspec.structs.replace(config.policy, patient_first_call=patient_first_call),
                )
            ).result.mission_time_s
            / 60
            for patient_first_call in (False, True)
        )
        yield without, patient - without


def slow_at_first(config: DroneConfig, extra_s: float) -> DroneConfig:
    """The scenario with servers on which a service's first call takes that much longer."""
    replace = msgspec.structs.replace
    servers = [
        replace(server, truth=replace(server.truth, first_extra_s=extra_s)) for server in config.servers
    ]
    return replace(config, servers=tuple(servers))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
