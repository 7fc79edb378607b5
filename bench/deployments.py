"""When servers pay with today's computers: `python -m bench.deployments`.

A field of 240 by 150 m is mapped in rows at 6 m/s. Two servers have ranges of 100 and 150 m. Calls have 3 % noise,
and legs 2 %. From 30 m there is a photo each 9 m and a row each 15 m. Photos of 48 tiles have twice the width:
from 60 m they show the same detail, each 18 m, in rows each 30 m. Demands want 10 s at their place. *Load* is the
drone's seconds for a photo times the photos that it takes a second on its rows. Each figure is the mean of missions
with the same seeds. `--keep` keeps the figures.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import msgspec
from bench.program import command_line
from bench.results import FOLDER, leave, read

from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate

SPEED_M_S, EAST_M, NORTH_M = 6.0, 240.0, 150.0
POLICIES = ("local-only", "look-ahead")
CHANCES = (0.0, 0.05)
SEEDS = 10
HEAD = (
    "drone's computer, model",
    "photo on drone / server, s",
    "load",
    "alone, min",
    "upwash, min",
    "saved, %",
)


class Deployment(NamedTuple):
    """A drone's computer with a model: seconds a photo there and on a server, and the altitude of the photos."""

    name: str
    local_s: float
    remote_s: float
    altitude_m: float = 30.0

    @property
    def every_m(self) -> float:
        """From one photo to the next."""
        return 0.3 * self.altitude_m

    @property
    def load(self) -> float:
        """The drone's seconds for a photo times the photos a second."""
        return self.local_s * SPEED_M_S / self.every_m


DEPLOYMENTS = (
    Deployment("Raspberry Pi 5, YOLOv8s", 0.15, 0.2),
    Deployment("Raspberry Pi 4, YOLOv8s", 0.7, 0.2),
    Deployment("Orin Nano, 48 tiles", 0.6, 1.7, 60.0),
    Deployment("Raspberry Pi 5, 48 tiles", 4.4, 1.7, 60.0),
    Deployment("Raspberry Pi 5, 48 tiles, slower server", 4.4, 3.7, 60.0),
    Deployment("Raspberry Pi 5, YOLOv9-c, 12 tiles", 8.0, 1.0),
    Deployment("Raspberry Pi 4, 48 tiles", 33.0, 1.7, 60.0),
)


class Flown(msgspec.Struct, frozen=True):
    """Mean minutes of a deployment alone and served, for each of CHANCES."""

    name: str
    local_s: float
    remote_s: float
    load: float
    alone_min: Sequence[float]
    served_min: Sequence[float]


class Flight(NamedTuple):
    """One mission to be flown."""

    deployment: Deployment
    policy: str
    chance: float
    seed: int


def fly(flight: Flight) -> tuple[Flight, float]:
    """The flight, and its mission's time in minutes."""
    run = simulate(scenario(flight), seed=flight.seed)
    assert run.completed
    return flight, run.mission_time_s / 60


def scenario(flight: Flight) -> dict[str, Any]:
    """The scenario of the flight."""
    deployment = flight.deployment
    mission = {
        "waypoints_m": list(row_ends(0.5 * deployment.altitude_m)),
        "altitude_m": deployment.altitude_m,
        "ground_speed_m_s": SPEED_M_S,
        "photos": {"every_m": deployment.every_m},
        "action_s": 10.0,
    }
    return {
        "mission": mission,
        "vehicle": {"acceleration_m_s2": 2.0},
        "service": [{"name": "detector", "local_call_s": calls_s(deployment.local_s)}],
        "server": [
            server("s1", 60.0, 40.0, 100.0, deployment.remote_s),
            server("s2", 180.0, 110.0, 150.0, deployment.remote_s),
        ],
        "event": {"probability": flight.chance},
        "noise": {"call": 0.03, "leg": 0.02},
        "policy": {"name": flight.policy},
    }


def row_ends(rows_m: float) -> Iterator[tuple[float, float]]:
    """The ends of the rows, back and forth."""
    for row in range(int(NORTH_M / rows_m) + 1):
        for end_m in (0.0, EAST_M) if row % 2 == 0 else (EAST_M, 0.0):
            yield end_m, row * rows_m


def server(name: str, east_m: float, north_m: float, range_m: float, call_s: float) -> dict[str, Any]:
    """A server of those calls."""
    return {
        "name": name,
        "east_m": east_m,
        "north_m": north_m,
        "range_m": range_m,
        "check_s": 11.5,
        "check_running_s": 3.5,
        "remote_call_s": calls_s(call_s),
    }


def calls_s(seconds: float) -> dict[str, float]:
    """The time of a call in both modes of the detector."""
    return {"light": seconds, "heavy": seconds}


def kept() -> list[Flown]:
    """The figures that were kept."""
    result = read("deployments")
    return [] if result is None else msgspec.convert(result.figures, list[Flown])


def rows(figures: Sequence[Flown]) -> Iterator[Sequence[str]]:
    """The lines of the table: without demands, and with."""
    for flown in figures:
        saved = (
            100 * (1 - served / alone)
            for alone, served in zip(flown.alone_min, flown.served_min, strict=True)
        )
        yield (
            flown.name,
            f"{flown.local_s:g} / {flown.remote_s:g}",
            f"{flown.load:.2g}",
            *(
                " / ".join(f"{minutes:.1f}" for minutes in each)
                for each in (flown.alone_min, flown.served_min)
            ),
            " / ".join(f"{round(share, 1) + 0.0:.1f}" for share in saved),
        )


def main() -> None:
    """Flies all of them and prints the table."""
    parser = command_line("deployments", __doc__)
    parser.add_argument("--keep", action="store_true", help="keep the figures in bench/results")
    options = parser.parse_args()
    deployments = DEPLOYMENTS[3:4] if options.quick else DEPLOYMENTS
    seeds = range(1, 2 if options.quick else 1 + SEEDS)
    wanted = itertools.starmap(Flight, itertools.product(deployments, POLICIES, CHANCES, seeds))
    with in_processes(fly, list(wanted)) as results:
        flown = dict(results)

    def minutes(deployment: Deployment, policy: str) -> list[float]:
        return [
            fmean(flown[Flight(deployment, policy, chance, seed)] for seed in seeds) for chance in CHANCES
        ]

    figures = [
        Flown(
            each.name, each.local_s, each.remote_s, each.load, *(minutes(each, policy) for policy in POLICIES)
        )
        for each in deployments
    ]
    for line in (HEAD, ("---",) * len(HEAD), *rows(figures)):
        print(f"| {' | '.join(line)} |")
    if options.keep:
        leave(FOLDER / "deployments.json", command="python -m bench.deployments --keep", figures=figures)


if __name__ == "__main__":
    main()
