"""How often the intervals of `upwash whatif` hold: flights in drawn worlds, predicted from the log of another policy.

Each drawn world of one drone that stops is flown under one policy, whose log predicts the others. The truth is the
same world under the other policy with another seed: other delays, and the same answers that demand an action.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import msgspec
from bench.program import command_line, machine
from msgspec.structs import replace

from upwash.config import Document, DroneConfig, waypoints
from upwash.core.policies.names import POLICIES
from upwash.errors import UsageError
from upwash.lab import processes
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario, with_policy
from upwash.lab.whatif import DRAWS, Prediction, Replays, what_if
from upwash.lab.worlds import draw_world
from upwash.sim.camera import eventful
from upwash.sim.chance import Chance

FIRST = 200_001
OTHER_SEED = 1_000_000


@dataclass(frozen=True)
class Pair:
    """A log and another policy: the times (s) that were flown, predicted and true."""

    world: int
    log: str
    flown_s: float
    predicted: Prediction
    true_s: float
    features: str

    @property
    def holds(self) -> bool:
        """Whether the truth is in the interval."""
        return self.predicted.low_s <= self.true_s <= self.predicted.high_s


def main() -> None:
    """Prints the coverage of the intervals, their widths, and whether the order is right."""
    parser = command_line("whatif", __doc__)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=FIRST, help="the first world")
    parser.add_argument("--draws", type=int, default=DRAWS, help="replays for each prediction")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="write the pairs there, one JSON object a line")
    options = parser.parse_args()
    wanted, draws = (3, 5) if options.quick else (options.pairs, options.draws)
    logging.disable()  # of the servers' faults
    print(machine())
    worlds = [(number, draws) for number in range(options.first, options.first + wanted + 10)]
    pairs: list[Pair] = []
    refused: list[str] = []
    with processes.here_first(pairs_of, worlds, workers=options.workers) as found:
        for of_world, why in found:
            pairs += of_world
            refused += [why] if why else []
            if options.rows and of_world:
                with options.rows.open("ab") as file:
                    file.writelines(msgspec.json.encode(pair) + b"\n" for pair in of_world)
            if len(pairs) >= wanted:
                break
    for line in summary(pairs):
        print(line)
    for why in sorted(set(refused)):
        print(f"refused: {refused.count(why)} worlds: {why}")


def pairs_of(part: tuple[int, int]) -> tuple[list[Pair], str]:
    """The pairs of a world, or why there are none."""
    number, draws = part
    document = draw_world(number)
    if "drone" in document:
        return [], "several drones"
    config = _pinned(document)
    log = list(POLICIES)[number % len(POLICIES)]
    run = simulate(replace(with_policy(config, log), seed=number))
    others = [policy for policy in POLICIES if policy != log]
    try:
        found = what_if(run.events, others, replays=Replays(draws, workers=1))
    except UsageError as error:
        return [], str(error)
    features = " ".join(name for name in ("heat", "fault", "event") if document.get(name))
    pairs = []
    for prediction in found.predictions:
        if prediction.policy == log:
            continue
        other = simulate(replace(with_policy(config, prediction.policy), seed=OTHER_SEED + number)).result
        pairs.append(Pair(number, log, run.result.mission_time_s, prediction, other.mission_time_s, features))
    return pairs, "; ".join(sorted(set(found.refused.values())))


def _pinned(document: Document) -> DroneConfig:
    """The scenario whose demanding answers do not change with the seed."""
    config = read_scenario(document)
    if config.event is None:
        return config
    there = eventful(config.event, waypoints(config.mission), Chance(config.seed))
    places = [waypoint.position for waypoint in there]
    areas = [
        {"east_m": at.east_m, "north_m": at.north_m, "radius_m": 0.5, "probability": 1.0} for at in places
    ]
    return read_scenario(document, overrides={"event": {"probability": 0.0, "areas": areas}})


def summary(pairs: Sequence[Pair]) -> Iterator[str]:
    """The figures of the page."""
    if not pairs:
        yield "no pairs"
        return
    yield f"{len(pairs)} pairs of {len({pair.world for pair in pairs})} worlds"
    yield _line("all", pairs)
    for log in POLICIES:
        yield _line(f"from a log of {log}", [pair for pair in pairs if pair.log == log])
    for name in ("heat", "fault", "event"):
        yield _line(f"with {name}", [pair for pair in pairs if name in pair.features])
    yield _line("with none of these", [pair for pair in pairs if not pair.features])
    right = wrong = 0
    for _, of_world in itertools.groupby(pairs, key=lambda pair: pair.world):
        for one, other in itertools.permutations(of_world, 2):
            if one.predicted.high_s < other.predicted.low_s:
                right += one.true_s < other.true_s
                wrong += one.true_s >= other.true_s
    yield f"order: {right} of {right + wrong} pairs of policies whose intervals do not overlap"


def _line(name: str, pairs: Sequence[Pair]) -> str:
    if not pairs:
        return f"{name}: none"
    holds = sum(pair.holds for pair in pairs)
    off = [abs(pair.predicted.time_s / pair.true_s - 1) for pair in pairs]
    wide = [(pair.predicted.high_s - pair.predicted.low_s) / 2 / pair.predicted.time_s for pair in pairs]
    return (
        f"{name}: {holds} of {len(pairs)} hold ({100 * holds / len(pairs):.1f} %), predicted within a median of "
        f"{100 * median(off):.1f} % (at most {100 * max(off):.1f}), ± {100 * median(wide):.1f} % in the median"
    )


if __name__ == "__main__":
    main()
