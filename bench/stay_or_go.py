"""What going on before answers gains on the thesis's heavy mission: `python -m bench.stay_or_go --keep`.

A drone that stays, a drone that always goes, and a drone that learns fly each mission with the same seed. An answer
demands 5 s at its waypoint with some probability. The gain is of the mission's time, in pairs of the same seed.
The result is kept in bench/results/stay_or_go.json, and `python -m bench.promises` brings it into
docs/calls.md.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from bench.program import command_line
from bench.results import FOLDER, leave

from upwash.lab.processes import in_processes
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.support.confidence import Mean, mean_of

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "thesis.toml"
CHANCES, QUICK_CHANCES = (0.0, 0.05, 0.1, 0.2, 0.5), (0.5,)
GOING = ("go", "learn")
ACTION_S = 5.0
NOISE = {"noise.call": 0.03, "noise.leg": 0.02}  # as `upwash compare` gives to a scenario without any
SEEDS, QUICK_SEEDS = 30, 2


class Gained(msgspec.Struct, frozen=True, kw_only=True):
    """What a manner gains over staying, in % of the mission's time, and how often it turned back on average."""

    chance: float
    manner: str
    missions: int
    stay_min: float
    gain_percent: float
    margin_percent: float
    turned_back: float


class Flight(NamedTuple):
    """One mission to be flown."""

    chance: float
    manner: str
    seed: int


class Flown(NamedTuple):
    """The result of one mission."""

    mission_s: float
    turned_back: int


def fly(flight: Flight) -> tuple[Flight, Flown]:
    """Simulates the mission."""
    overrides = {
        "policy.stay_or_go": flight.manner,
        "event.probability": flight.chance,
        "mission.action_s": ACTION_S,
        **NOISE,
    }
    run = simulate(read_scenario(SCENARIO, seed=flight.seed, overrides=overrides))
    assert run.result.completed
    return flight, Flown(run.result.mission_time_s, run.result.totals.turns_back)


def gained(flown: dict[Flight, Flown], chances: Sequence[float], seeds: Sequence[int]) -> Iterator[Gained]:
    """The gains, mission by mission against the one of the same seed that stays."""
    for chance, manner in itertools.product(chances, GOING):
        stays = [flown[Flight(chance, "stay", seed)].mission_s for seed in seeds]
        goes = [flown[Flight(chance, manner, seed)] for seed in seeds]
        gain: Mean = mean_of([100 * (1 - its.mission_s / s) for its, s in zip(goes, stays, strict=True)])
        yield Gained(
            chance=chance,
            manner=manner,
            missions=len(seeds),
            stay_min=sum(stays) / len(stays) / 60,
            gain_percent=gain.value,
            margin_percent=gain.margin,
            turned_back=sum(its.turned_back for its in goes) / len(goes),
        )


HEAD = (
    "answers with an act",
    "stay, min",
    *(f"{manner} gains" for manner in GOING),
    "turned back, go / learn",
)


def rows(found: Sequence[Gained]) -> Iterator[tuple[str, ...]]:
    """A row for each probability."""
    for chance, group in itertools.groupby(found, key=lambda each: each.chance):
        own = list(group)
        gains = (f"{each.gain_percent:.1f} ± {each.margin_percent:.1f} %" for each in own)
        turned = " / ".join(f"{each.turned_back:.1f}" for each in own)
        yield f"{100 * chance:g} %", f"{own[0].stay_min:.2f}", *gains, turned


def main() -> None:
    """Flies all of them and prints the table."""
    parser = command_line("stay_or_go", __doc__)
    parser.add_argument("--keep", action="store_true", help="keep what comes out in bench/results")
    options = parser.parse_args()
    chances = QUICK_CHANCES if options.quick else CHANCES
    seeds = range(1, 1 + (QUICK_SEEDS if options.quick else SEEDS))
    wanted = [Flight(*each) for each in itertools.product(chances, ("stay", *GOING), seeds)]
    with in_processes(fly, wanted) as results:
        flown = dict(results)
    found = list(gained(flown, chances, seeds))
    for row in (HEAD, *rows(found)):
        print("  ".join(f"{cell:>28}" for cell in row))
    if options.keep:
        leave(FOLDER / "stay_or_go.json", command="python -m bench.stay_or_go --keep", figures=found)
    print(f"{len(wanted)} missions", file=sys.stderr)


if __name__ == "__main__":
    main()
