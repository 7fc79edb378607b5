"""What flying rows without stopping gains, in minutes: `python -m bench.rows`.

The field of scenarios/on-the-move.toml, with 3 % noise on calls and 2 % on legs. An answer demands 5 s at its place
with some probability. The second table maps the same field at 75 % overlap, 1,485 photos without a demand; its last
line has the speed that each drone chooses by itself (`mission.speed = "auto"`).
Each figure is the mean of missions with the same seeds.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from bench.program import command_line

from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "on-the-move.toml"
CHANCES, QUICK_CHANCES = (0.0, 0.05, 0.1, 0.2, 0.5), (0.1,)
AUTO_M_S = 0.0
SPEEDS, QUICK_SPEEDS = (2.0, 4.0, 6.0, 8.0, AUTO_M_S), (4.0,)
NOISE = {"call": 0.03, "leg": 0.02}
SEEDS = 10
FIELD_M, ROWS, EVERY_M = 200.0, 33, 4.5  # 75 % overlap of photos of 24 by 18 m, nearly
PHOTO_S = 0.4  # of the mapping camera

MANNERS: Mapping[str, tuple[str, str, bool]] = {  # policy, stay_or_go, whether in rows
    "stops, waits": ("look-ahead", "stay", False),
    "stops, learns": ("look-ahead", "learn", False),
    "rows": ("look-ahead", "stay", True),
    "rows, learns": ("look-ahead", "learn", True),
    "rows, drone alone": ("local-only", "stay", True),
}


class Flight(NamedTuple):
    """One mission to be flown; at AUTO_M_S it chooses its speed."""

    manner: str
    speed_m_s: float
    chance: float
    maps: bool
    seed: int


def scenario(flight: Flight) -> dict[str, Any]:
    """The scenario of the flight."""
    document = tomllib.loads(SCENARIO.read_text())
    policy, stay_or_go, in_rows = MANNERS[flight.manner]
    mission = document["mission"]
    mission["ground_speed_m_s"] = flight.speed_m_s
    if flight.speed_m_s == AUTO_M_S:
        del mission["ground_speed_m_s"]
        mission["speed"] = "auto"
    if flight.maps:
        del mission["grid"]
        mission["photos"] = {"every_m": EVERY_M}
        mission["waypoints_m"] = list(mapping_rows() if in_rows else mapping_spots())
        document["camera"] = {"photo_s": PHOTO_S}
    if not in_rows:
        del mission["photos"]
    event = {"probability": flight.chance}
    return document | {"event": event, "noise": NOISE, "policy": {"name": policy, "stay_or_go": stay_or_go}}


def mapping_rows() -> Iterator[tuple[float, float]]:
    """The ends of the rows, back and forth."""
    for row in range(ROWS):
        ends = (0.0, FIELD_M) if row % 2 == 0 else (FIELD_M, 0.0)
        for end_m in ends:
            yield end_m, row * FIELD_M / (ROWS - 1)


def mapping_spots() -> Iterator[tuple[float, float]]:
    """The places of the photos on those rows."""
    ends = list(mapping_rows())
    for (start_m, north_m), (end_m, _) in zip(ends[::2], ends[1::2], strict=True):
        for number in range(int(FIELD_M / EVERY_M) + 1):
            yield start_m + (1 if end_m > start_m else -1) * number * EVERY_M, north_m


def fly(flight: Flight) -> tuple[Flight, float]:
    """The flight, and its mission's time in minutes."""
    run = simulate(scenario(flight), seed=flight.seed)
    assert run.completed
    return flight, run.mission_time_s / 60


def main() -> None:
    """Flies all of them and prints the tables."""
    options = command_line("rows", __doc__).parse_args()
    chances = QUICK_CHANCES if options.quick else CHANCES
    speeds = QUICK_SPEEDS if options.quick else SPEEDS
    seeds = range(1, 2 if options.quick else 1 + SEEDS)
    wanted = [
        Flight(*each, False, seed) for each in itertools.product(MANNERS, (4.0,), chances) for seed in seeds
    ]
    maps = [
        Flight(manner, speed_m_s, 0.0, True, 1)
        for manner, speed_m_s in itertools.product(MANNERS, speeds)
        if manner == "rows" or (not options.quick and (MANNERS[manner][2] or speed_m_s != AUTO_M_S))
    ]
    with in_processes(fly, [*wanted, *maps]) as results:
        flown = dict(results)

    def minutes(manner: str, speed_m_s: float, chance: float, *, maps: bool) -> str:
        times = [
            time
            for flight, time in flown.items()
            if (flight.manner, flight.speed_m_s, flight.chance, flight.maps)
            == (manner, speed_m_s, chance, maps)
        ]
        return f"{fmean(times):.1f}" if times else ""

    print("4 m/s, an answer demands something |", " | ".join(MANNERS))
    for chance in chances:
        print(
            f"{100 * chance:g} % |",
            " | ".join(minutes(manner, 4.0, chance, maps=False) for manner in MANNERS),
        )
    print("1,485 photos |", " | ".join(MANNERS))
    for speed_m_s in speeds:
        cells = (minutes(manner, speed_m_s, 0.0, maps=True) for manner in MANNERS)
        print(f"{speed_m_s:g} m/s |" if speed_m_s else "auto |", " | ".join(cells))


if __name__ == "__main__":
    main()
