"""Mission times as a table in a file: one line for each world and seed, one column for each variant."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.results import FOLDER

TABLE = FOLDER / "gains.csv"
_BEFORE = ("group", "world", "seed", "bound_s")


class Missions(NamedTuple):
    """The missions of all variants in one world with one seed: seconds, and those of the theoretical minimum.

    A variant that did not fly there is not in `times_s`.
    """

    group: str
    world: str
    seed: int
    bound_s: float
    times_s: Mapping[str, float]


class Kept(NamedTuple):
    """The missions of a ladder of variants, sorted by world."""

    variants: Sequence[str]
    missions: Sequence[Missions]


def write(file: Path, kept: Kept) -> None:
    """Writes them down, to the millisecond."""
    with file.open("w", newline="") as out:
        table = csv.writer(out, lineterminator="\n")
        table.writerow((*_BEFORE, *kept.variants))
        for row in kept.missions:
            times = (f"{row.times_s[name]:.3f}" if name in row.times_s else "" for name in kept.variants)
            table.writerow((row.group, row.world, row.seed, f"{row.bound_s:.3f}", *times))


def read(file: Path) -> Kept:
    """What was written."""
    with file.open(newline="") as lines:
        table = csv.DictReader(lines)
        variants = [name for name in table.fieldnames or () if name not in _BEFORE]
        return Kept(
            variants,
            [
                Missions(
                    row["group"],
                    row["world"],
                    int(row["seed"]),
                    float(row["bound_s"]),
                    {name: float(row[name]) for name in variants if row[name]},
                )
                for row in table
            ],
        )
