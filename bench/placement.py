"""Two servers placed together against every pair of a grid of 10 m: `python -m bench.placement`.

For the thesis's field and drawn ones. A pair is simulated unless a bound rules it out: the mission on a cool drone
alone, less what a server saves at each waypoint in the range of either. See docs/check.md.
"""

from __future__ import annotations

import copy
import itertools
import math
import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.program import command_line, machine

from upwash import simulate
from upwash.config.drone_file import drone_config
from upwash.config.places import waypoints
from upwash.config.reading import read_document
from upwash.core.geo import Position
from upwash.preflight.placement import Places, Trials, best_places

GRID_M = 10.0
THESIS = Path(__file__).parents[1] / "scenarios" / "thesis.toml"
Field = dict[str, Any]


def main() -> None:
    """Measures and prints one line for each field."""
    quick = command_line("placement", __doc__).parse_args().quick
    print(machine())
    print("| field | one after the other | together | best pair | pairs simulated |\n|---|---|---|---|---|")
    for name, field in quick_fields() if quick else fields():
        pairs = Pairs(field)
        trials = Trials(pairs.times_s)
        first = trials.best([(at,) for at in pairs.grid], than=())
        greedy_s = trials.time_s(trials.best([(*first, at) for at in pairs.grid], than=first))
        found_s = trials.time_s(best_places(pairs.way, pairs.ranges_m, trials))
        best_s, simulated = pairs.best_s(found_s)
        times = " | ".join(f"{time_s:.1f} s" for time_s in (greedy_s, found_s, best_s))
        print(f"| {name} | {times} | {simulated} of {math.comb(len(pairs.grid), 2)} |", flush=True)


def quick_fields() -> Iterator[tuple[str, Field]]:
    """A field of a few waypoints."""
    name, field = next(fields())
    field["mission"]["grid"] = {"columns": 3, "rows": 3, "spacing_m": 20.0}
    field["server"][0]["range_m"] = 15.0
    yield name, field


def fields() -> Iterator[tuple[str, Field]]:
    """The thesis's field and drawn ones, by name; each has one server, whose place does not count."""
    thesis = read_document(THESIS)
    yield "thesis", {**thesis, "server": thesis["server"][:1]}
    for seed in range(1, 4):
        draw = random.Random(seed)
        remote_s, local_s, running_s = draw.uniform(0.3, 2.0), draw.uniform(4.0, 12.0), draw.uniform(2.0, 5.0)
        field = copy.deepcopy(thesis)
        for table in ("heat", "noise"):
            field.pop(table, None)
        field["mission"]["grid"] = {
            "columns": draw.randint(7, 12),
            "rows": draw.randint(7, 12),
            "spacing_m": draw.choice((15.0, 20.0, 25.0)),
        }
        field["mission"]["ground_speed_m_s"] = draw.uniform(3.0, 8.0)
        field["service"][0]["local_call_s"] = {"light": local_s, "heavy": local_s}
        field["server"] = field["server"][:1]
        field["server"][0] |= {
            "range_m": draw.uniform(40.0, 110.0),
            "check_running_s": running_s,
            "check_s": running_s + draw.uniform(2.0, 10.0),
            "remote_call_s": {"light": remote_s, "heavy": remote_s},
        }
        yield f"drawn {seed}", field


class Pairs:
    """The missions of one field with servers at any places."""

    def __init__(self, field: Field) -> None:
        self._field = field
        config = drone_config(field, THESIS)
        self.way = [waypoint.position for waypoint in waypoints(config.mission)]
        easts_m, norths_m = [at.east_m for at in self.way], [at.north_m for at in self.way]
        self.grid = [Position(east_m, north_m) for east_m in _steps(easts_m) for north_m in _steps(norths_m)]
        server = field["server"][0]
        self.ranges_m = [server["range_m"]] * 2
        mode = config.mission.mode
        self._saved_s = field["service"][0]["local_call_s"][mode] - server["remote_call_s"][mode]
        cool = {key: value for key, value in field.items() if key != "heat"}
        first_s = field["service"][0].get("local_first_extra_s", 0.0)
        self._alone_s = _time_s({**cool, "server": []}) - first_s

    def times_s(self, trials: Sequence[Places]) -> list[float]:
        """The mission time of each trial."""
        return [self._time_s(places) for places in trials]

    def best_s(self, least_s: float) -> tuple[float, int]:
        """The shortest mission of all pairs, at most `least_s`; and how many pairs were simulated."""
        covered = [
            sum(1 << number for number, at in enumerate(self.way) if _apart_m(at, place) <= self.ranges_m[0])
            for place in self.grid
        ]
        bounds = sorted(
            (self._alone_s - self._saved_s * (covered[one] | covered[other]).bit_count(), one, other)
            for one, other in itertools.combinations(range(len(self.grid)), 2)
        )
        for number, (bound_s, one, other) in enumerate(bounds):
            if bound_s >= least_s:
                return least_s, number
            time_s = self._time_s((self.grid[one], self.grid[other]))
            assert time_s >= bound_s - 1e-6, "the bound does not hold"
            least_s = min(least_s, time_s)
        return least_s, len(bounds)

    def _time_s(self, places: Places) -> float:
        like = self._field["server"][0]
        servers = [
            {**like, "name": f"s{number}", "east_m": at.east_m, "north_m": at.north_m}
            for number, at in enumerate(places)
            if at is not None
        ]
        return _time_s({**self._field, "server": servers})


def _time_s(scenario: Field) -> float:
    flown = simulate(scenario)
    return math.inf if flown.failure or flown.mission_time_s is None else flown.mission_time_s


def _steps(values_m: Sequence[float]) -> list[float]:
    low_m = min(values_m)
    return [low_m + GRID_M * step for step in range(int((max(values_m) - low_m) // GRID_M) + 1)]


def _apart_m(one: Position, other: Position) -> float:
    return math.hypot(one.east_m - other.east_m, one.north_m - other.north_m)


if __name__ == "__main__":
    main()
