"""What patience with a first call is worth: `python -m bench.first_call`.

Every scenario of one drone and the thesis's eight cells, under `look-ahead` and `location-aware`, with and without
`patient_first_call`. The first call of a service on a server takes 0, 0.5, 2 or 5 s longer than the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean

import msgspec
from bench.program import command_line

from upwash.config.drone import DroneConfig
from upwash.lab.campaigns.comparison import NamedScenario, read_scenarios, thesis_scenarios
from upwash.lab.run import simulate
from upwash.lab.scenario import with_policy
from upwash.support.confidence import mean_of

POLICIES = ("look-ahead", "location-aware")
EXTRAS_S = (0.0, 0.5, 2.0, 5.0)
SCENARIOS = sorted((Path(__file__).parents[1] / "scenarios").glob("*.toml"))


def main() -> None:
    """Flies and prints minutes without patience, and what it changes, paired by seed, ± 95 %."""
    parser = command_line("first_call", __doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=30)
    options = parser.parse_args()
    if options.quick:
        table(POLICIES[:1], EXTRAS_S[1:2], thesis_scenarios()[:1], seeds=2)
    else:
        own = [scenario for scenario in read_scenarios(SCENARIOS) if not scenario.config.drones]
        table(POLICIES, EXTRAS_S, [*thesis_scenarios(), *own], seeds=options.seeds)


def table(
    policies: Sequence[str], extras_s: Sequence[float], scenarios: Sequence[NamedScenario], *, seeds: int
) -> None:
    """Prints a line for each policy, longer first call and scenario."""
    print("| policy | first call | scenario | without | changes by | |")
    print("|---|---|---|---|---|---|")
    for policy, extra_s, scenario in product(policies, extras_s, scenarios):
        without_min, changes_min = zip(*flown(scenario, policy, extra_s, seeds), strict=True)
        mean, change = fmean(without_min), mean_of(changes_min)
        print(
            f"| {policy} | +{extra_s:g} s | {scenario.name} | {mean:.2f} | {change.value:+.2f} ± {change.margin:.2f} "
            f"| {100 * change.value / mean:+.1f} % |",
            flush=True,
        )


def flown(scenario: NamedScenario, policy: str, extra_s: float, seeds: int) -> Iterator[tuple[float, float]]:
    """Minutes of each seed's mission without patience, and the difference with patience.

    Calls are not hedged and failed servers are left alone: hedging would give a first call that time anyway.
    """
    config = with_policy(slow_at_first(scenario.config, extra_s), policy)
    for seed in range(1, seeds + 1):
        without, patient = (
            simulate(
                msgspec.structs.replace(
                    config,
                    seed=seed,
                    policy=msgspec.structs.replace(
                        config.policy,
                        patient_first_call=patient_first_call,
                        blacklist_s=60.0,
                        probe=None,
                        hedge=False,
                    ),
                )
            ).result.mission_time_s
            / 60
            for patient_first_call in (False, True)
        )
        yield without, patient - without


def slow_at_first(config: DroneConfig, extra_s: float) -> DroneConfig:
    """The scenario with servers whose first calls take `extra_s` longer."""
    replace = msgspec.structs.replace
    servers = [
        replace(server, truth=replace(server.truth, first_extra_s=extra_s)) for server in config.servers
    ]
    return replace(config, servers=tuple(servers))


if __name__ == "__main__":
    main()
