"""How often the intervals of `upwash whatif` hold: flights in drawn worlds, predicted from the log of another policy.

Each drawn world of one drone that stops is flown under one policy, whose log predicts the others. The truth is the
same world under the other policy with another seed: other delays, and the same answers that demand an action. Each
kind of worlds has as many pairs.
"""

from __future__ import annotations

import itertools
import logging
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import msgspec
from bench.program import command_line, machine
from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.config.reading import Document
from upwash.core.policies.names import POLICIES
from upwash.errors import UsageError
from upwash.lab import processes
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario, with_policy
from upwash.lab.whatif import DRAWS, ReplayedTime, Replays, what_if
from upwash.lab.worlds import draw_world
from upwash.sim.camera import eventful
from upwash.sim.chance import Chance

FIRST = 200_001
OTHER_SEED = 1_000_000


def _calm(document: Document, _: random.Random) -> Document:
    return {key: table for key, table in document.items() if key not in ("heat", "fault", "event")}


def _heated(document: Document, chance: random.Random, *, load_w: float = 4.0) -> Document:
    """The drone's computer is busy with calls of 8 to 15 s for much of the time."""
    (detector,) = document["service"]
    heavy_s = chance.uniform(8.0, 15.0)
    return {
        **document,
        "mission": {**document["mission"], "mode": "heavy"},
        "service": [{**detector, "local_call_s": {"light": heavy_s / 3, "heavy": heavy_s}}],
        "heat": {"ambient_c": chance.uniform(20.0, 50.0), "load_w": load_w},
    }


KINDS: Mapping[str, Callable[[Document, random.Random], Document | None]] = {  # None: another world
    "as drawn": lambda document, _: document,
    "no heat, faults and demands": _calm,
    "a computer in heat, 4 W": _heated,
    "a computer in heat, 2 to 4 W": lambda world, chance: _heated(world, chance, load_w=chance.uniform(2, 4)),
    "a computer in heat, 5 to 8 W": lambda world, chance: _heated(world, chance, load_w=chance.uniform(5, 8)),
    "faults": lambda document, _: document if document.get("fault") else None,
    "demands": lambda document, _: document if document.get("event") else None,
}


@dataclass(frozen=True)
class Pair:
    """A log and another policy: the times (s) that were flown, predicted and true."""

    kind: str
    world: int
    log: str
    flown_s: float
    predicted: ReplayedTime
    true_s: float
    notes: Sequence[str]

    @property
    def holds(self) -> bool:
        """Whether the truth is in the interval."""
        return self.predicted.low_s <= self.true_s <= self.predicted.high_s


def main() -> None:
    """Prints the coverage of the intervals, their widths, and whether the order is right."""
    parser = command_line("whatif", __doc__)
    parser.add_argument("--pairs", type=int, default=100, help="of each kind")
    parser.add_argument("--kind", choices=KINDS, help="only that kind")
    parser.add_argument("--first", type=int, default=FIRST, help="the first world")
    parser.add_argument("--draws", type=int, default=DRAWS, help="replays for each prediction")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="write the pairs there, one JSON object a line")
    options = parser.parse_args()
    wanted, draws = (3, 5) if options.quick else (options.pairs, options.draws)
    logging.disable()  # of the servers' faults
    print(machine())
    pairs: list[Pair] = []
    refused: list[str] = []
    for kind in [options.kind] if options.kind else list(KINDS)[: 1 if options.quick else None]:
        worlds = [(kind, number, draws) for number in range(options.first, options.first + 4 * wanted)]
        of_kind: list[Pair] = []
        with processes.here_first(pairs_of, worlds, workers=options.workers) as found:
            for of_world, why in found:
                of_kind += of_world
                refused += [why] if why else []
                if len(of_kind) >= wanted:
                    break
        print(_line(kind, of_kind), flush=True)
        pairs += of_kind
    if options.rows:
        options.rows.write_bytes(b"".join(msgspec.json.encode(pair) + b"\n" for pair in pairs))
    for line in summary(pairs):
        print(line)
    for why in sorted(set(refused)):
        print(f"refused: {refused.count(why)} worlds: {why}")


def pairs_of(part: tuple[str, int, int]) -> tuple[list[Pair], str]:
    """The pairs of a world, or why there are none."""
    kind, number, draws = part
    document = KINDS[kind](draw_world(number), random.Random(number))
    if document is None:
        return [], ""
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
    flown_s, pairs = run.result.mission_time_s, []
    for prediction in found.predictions:
        if prediction.policy == log:
            continue
        other = simulate(replace(with_policy(config, prediction.policy), seed=OTHER_SEED + number)).result
        pairs.append(Pair(kind, number, log, flown_s, prediction, other.mission_time_s, found.notes))
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
    right = wrong = 0
    for _, of_world in itertools.groupby(pairs, key=lambda pair: (pair.kind, pair.world)):
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
