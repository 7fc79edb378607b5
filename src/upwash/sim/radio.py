"""Goodput by distance, from tables that a network simulator computed."""

from __future__ import annotations

import bisect
import csv
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Protocol

from upwash.config.traces import Stamp, Trace, read_goodput_trace, stamp_of
from upwash.config.truth import ServerTruth
from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.support.input_files import read_file, text_of
from upwash.support.text import counted, named_twice, number_of, printable

_MOST_BYTES = 10_000_000
_LONGEST_PROBLEM = 200  # characters
_BUNDLED = {"disc54": "goodput_54.csv", "disc12": "goodput_12.csv"}


@dataclass(frozen=True, slots=True)
class Spot:
    """A place and a time of sending; without a position at the best place, without a time at the best time."""

    distance_m: float
    position: Position | None = None
    now_s: float | None = None


class Goodput(Protocol):
    """How fast the link of a server is."""

    def transfer_s(self, data_bytes: int, at: Spot) -> float:
        """The transfer time in seconds; infinite if nothing gets through."""


@dataclass(frozen=True)
class GoodputTable:
    """Goodput in bit/s at ascending distances in metres; linear between them, 0 beyond the last."""

    distances_m: Sequence[float]
    goodput_bit_s: Sequence[float]

    def transfer_s(self, data_bytes: int, at: Spot) -> float:
        """The transfer time in seconds over the distance; infinite if nothing gets through."""
        goodput_bit_s = self.at(at.distance_m)
        return 8 * data_bytes / goodput_bit_s if goodput_bit_s > 0 else float("inf")

    def at(self, distance_m: float) -> float:
        """The goodput at the distance, in bit/s."""
        after = bisect.bisect_left(self.distances_m, distance_m)
        if after == 0:
            return self.goodput_bit_s[0]
        if after == len(self.distances_m):
            return 0.0
        before = after - 1
        span_m = self.distances_m[after] - self.distances_m[before]
        share = (distance_m - self.distances_m[before]) / span_m
        return self.goodput_bit_s[before] * (1 - share) + self.goodput_bit_s[after] * share


@dataclass(frozen=True)
class SteadyGoodput:
    """The same goodput wherever the drone is, in bit/s."""

    goodput_bit_s: float

    def transfer_s(self, data_bytes: int, _at: Spot) -> float:
        """The transfer time in seconds, the same everywhere."""
        return 8 * data_bytes / self.goodput_bit_s


@dataclass(frozen=True)
class GoodputInTime:
    """Goodput in bit/s from each of the ascending times (s) on, as a file has it; before the first as from there."""

    times_s: Sequence[float]
    goodput_bit_s: Sequence[float]

    def transfer_s(self, data_bytes: int, at: Spot) -> float:
        """The transfer time in seconds, over changes of the goodput; infinite if nothing gets through any more."""
        left_bits = 8.0 * data_bytes
        if at.now_s is None:
            return left_bits / max(self.goodput_bit_s)
        first, now_s = max(0, bisect.bisect_right(self.times_s, at.now_s) - 1), at.now_s
        for number in range(first, len(self.times_s) - 1):
            goodput_bit_s, until_s = self.goodput_bit_s[number], self.times_s[number + 1]
            if left_bits <= goodput_bit_s * (until_s - now_s):
                return now_s + left_bits / goodput_bit_s - at.now_s if left_bits else 0.0
            left_bits -= goodput_bit_s * (until_s - now_s)
            now_s = until_s
        last_bit_s = self.goodput_bit_s[-1]
        return now_s + left_bits / last_bit_s - at.now_s if last_bit_s else math.inf


@dataclass(frozen=True)
class GoodputByPlace:
    """Goodput in bit/s at places; anywhere else that of the nearest place."""

    places: Sequence[tuple[float, float, float]]  # east and north in metres, and bit/s

    def transfer_s(self, data_bytes: int, at: Spot) -> float:
        """The transfer time in seconds; infinite where nothing gets through."""
        if at.position is None:
            return 8 * data_bytes / max(place[2] for place in self.places)
        here = at.position.east_m, at.position.north_m
        goodput_bit_s = min(self.places, key=lambda place: math.dist(place[:2], here))[2]
        return 8 * data_bytes / goodput_bit_s if goodput_bit_s > 0 else math.inf


def traced(trace: Trace) -> Goodput:
    """The goodput of a trace."""
    columns = list(zip(*trace.rows, strict=True))
    if len(columns) > 2:
        return GoodputByPlace([(row[0], row[1], row[2]) for row in trace.rows])
    return (GoodputInTime if trace.columns[0] == "t_s" else GoodputTable)(*columns)


@lru_cache
def _traced_in(file: Path, _stamp: Stamp) -> Goodput:
    return traced(read_goodput_trace(file))


def goodput_of(truth: ServerTruth, service: str) -> Goodput | None:
    """The goodput for the service's calls to the server; None if their delays are given end to end."""
    if truth.goodput_csv is not None:
        return _traced_in(truth.goodput_csv, stamp_of(truth.goodput_csv))
    table = read_goodput(truth.radio)
    if table is not None or service in truth.remote_call_s or truth.bandwidth_bit_s is None:
        return table
    return SteadyGoodput(truth.bandwidth_bit_s)


@lru_cache
def read_goodput(radio: str) -> GoodputTable | None:
    """The table of that name or csv file; None for "fixed"."""
    if radio == "fixed":
        return None
    bundled = _BUNDLED.get(radio)
    try:
        if bundled:
            text = (files("upwash.sim") / bundled).read_text(encoding="utf-8")
        else:
            text = text_of(read_file(Path(radio), most_bytes=_MOST_BYTES))
        return _table(_rows(text))
    except (OSError, ValueError, csv.Error) as error:
        problem = f"{type(error).__name__}: {printable(str(error), _LONGEST_PROBLEM)}"
        raise UsageError(
            f"radio {radio!r}: {problem}; it must be a csv file with the columns distance_m, ascending, and "
            "goodput_mbit_s"
        ) from error


def _rows(text: str) -> list[tuple[float, float]]:
    """Distance in metres and goodput in bit/s of each row, by the column names of the first."""
    rows = csv.reader(line for line in text.splitlines() if line and not line.startswith("#"))
    names = next(rows, [])
    if twice := named_twice(names):
        raise ValueError(f"two columns are named {twice}")
    distance, goodput = names.index("distance_m"), names.index("goodput_mbit_s")
    table = []
    for row in rows:
        if len(row) <= max(distance, goodput):
            raise ValueError(f"a row of {counted(len(row), 'column')}: {','.join(row)}")
        table.append((number_of(row[distance]), 1e6 * number_of(row[goodput])))
    return table


def _table(rows: Sequence[tuple[float, float]]) -> GoodputTable:
    if not rows:
        raise ValueError("no rows")
    distances_m, goodput_bit_s = zip(*rows, strict=True)
    if not all(0 <= number < math.inf for number in (*distances_m, *goodput_bit_s)):
        raise ValueError("a number that is negative or not finite")
    if any(near >= far for near, far in itertools.pairwise(distances_m)):
        raise ValueError("distances that do not ascend")
    return GoodputTable(distances_m, goodput_bit_s)
