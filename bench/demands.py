"""What a map of demands gains over several flights of a field with a bad corner: `python -m bench.demands`.

The thesis's heavy mission with `stay_or_go = "learn"`, with calls of 0.7 s and of 4 s on servers. Answers in a circle
demand 5 s more often than elsewhere. The gain is of the mission's time, in pairs of the same seed, against the drone
that learns without a map. Each flight of a field reads the map that the flights before it have written.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from bench.program import command_line
from bench.stay_or_go import ACTION_S, NOISE, SCENARIO

from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate
from upwash.support.confidence import mean_of

CALLS_S, QUICK_CALLS_S = (0.7, 4.0), (4.0,)
FIELDS = {  # probability elsewhere and in the corner of 60 m around (160, 160)
    "3 %, corner 60 %": (0.03, 0.6),
    "3 %, corner 80 %": (0.03, 0.8),
    "10 %, corner 10 %": (0.1, 0.1),
}
FLIGHTS, SEEDS, QUICK_SEEDS = 4, 30, 2


class Season(NamedTuple):
    """Flights of one field, one after the other."""

    field: str
    call_s: float
    seed: int


def fly(season: Season) -> tuple[Season, list[float]]:
    """The gain of each flight, in %."""
    everywhere, corner = FIELDS[season.field]
    area = {"east_m": 160.0, "north_m": 160.0, "radius_m": 60.0, "probability": corner}
    overrides: dict[str, Any] = {
        "policy.stay_or_go": "learn",
        "event": {"probability": everywhere, "areas": [area]},
        "mission.action_s": ACTION_S,
        "server.s1.remote_call_s": season.call_s,
        "server.s2.remote_call_s": season.call_s,
        **NOISE,
    }
    gains = []
    with tempfile.TemporaryDirectory() as folder:
        mapped = {**overrides, "policy.demand_map": str(Path(folder) / "demands.json")}
        for flight in range(FLIGHTS):
            seed = 1000 * flight + season.seed
            without = simulate(SCENARIO, seed=seed, overrides=overrides)
            with_map = simulate(SCENARIO, seed=seed, overrides=mapped, keep_demands=True)
            assert without.mission_time_s and with_map.mission_time_s
            gains.append(100 * (1 - with_map.mission_time_s / without.mission_time_s))
    return season, gains


def main() -> None:
    """Flies all of them and prints the table."""
    options = command_line("demands", __doc__).parse_args()
    calls_s = QUICK_CALLS_S if options.quick else CALLS_S
    seeds = range(1, 1 + (QUICK_SEEDS if options.quick else SEEDS))
    fields = list(FIELDS)[1:2] if options.quick else list(FIELDS)
    with in_processes(fly, [Season(*each) for each in itertools.product(fields, calls_s, seeds)]) as results:
        flown = dict(results)
    numbers = " | ".join(f"flight {number + 1}" for number in range(FLIGHTS))
    print(f"| an answer demands something | calls | {numbers} |")
    for field, call_s in itertools.product(fields, calls_s):
        columns = zip(*(flown[Season(field, call_s, seed)] for seed in seeds), strict=True)
        cells = (f"{(gain := mean_of(column)).value:.1f} ± {gain.margin:.1f} %" for column in columns)
        print(f"| {field} | {call_s:g} s | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
