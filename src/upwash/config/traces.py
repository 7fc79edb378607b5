"""Traces in CSV files, for simulations: measured times of a server's computing, and the goodput of its link.

The first line names the columns. A line that begins with # is left out.

    service_csv   operation, seconds             a call draws one of its operation's times, with the scenario's seed
    goodput_csv   t_s, bit_s                     from that time of the simulation on, until the next row
                  distance_m, bit_s              straight between the rows, and nothing beyond the last
                  east_m, north_m, bit_s         of the nearest row
"""

from __future__ import annotations

import csv
import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from msgspec import Struct

from upwash.errors import ConfigError
from upwash.support.input_files import read_named_text
from upwash.support.text import printable

_MOST_BYTES = 50_000_000
_MOST_ROWS = 1_000_000
_LONGEST = 60  # characters of a value that is quoted
_LARGEST = 1e15
_KINDS = (("t_s", "bit_s"), ("distance_m", "bit_s"), ("east_m", "north_m", "bit_s"))
_SIGNED = ("east_m", "north_m")


class GoodputTrace(Struct, frozen=True):
    """Goodput in bit/s at the values of `columns`: a time, a distance, or a place; `rows` are in the file's order."""

    columns: tuple[str, ...]
    rows: Sequence[tuple[float, ...]]


@lru_cache
def read_service_times(file: Path) -> Mapping[str, Sequence[float]]:
    """The times (s) of each operation, named as in the file; raises ConfigError with the line and the column."""
    times: dict[str, list[float]] = defaultdict(list)
    lines = _lines(file)
    columns = _header(file, next(lines, (1, [])), (("operation", "seconds"),))
    for line, row in lines:
        operation, seconds = (_cell(file, line, row, columns, name) for name in ("operation", "seconds"))
        if not operation:
            raise _problem(
                file, line, "operation", 'empty: name an operation, such as "detector.process_photo[heavy]"'
            )
        times[operation].append(_number(file, line, "seconds", seconds))
    if not times:
        raise ConfigError(str(file), "", "no rows: add one for each measured call, operation and seconds")
    return {operation: tuple(seconds) for operation, seconds in times.items()}


@lru_cache
def read_goodput_trace(file: Path) -> GoodputTrace:
    """The trace; raises ConfigError with the line and the column."""
    lines = _lines(file)
    columns = _header(file, next(lines, (1, [])), _KINDS)
    kind = next(kind for kind in _KINDS if set(kind) <= columns.keys())
    rows: list[tuple[float, ...]] = []
    for line, row in lines:
        rows.append(tuple(_number(file, line, name, _cell(file, line, row, columns, name)) for name in kind))
        if len(kind) == 2 and len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise _problem(
                file, line, kind[0], f"{rows[-1][0]:g} follows {rows[-2][0]:g}: let the values ascend"
            )
    if not rows:
        raise ConfigError(str(file), "", f"no rows: add some, with the columns {' and '.join(kind)}")
    if not any(row[-1] for row in rows):
        raise ConfigError(
            str(file), "", "nothing gets through in any row: give a bit_s above 0 in one of them"
        )
    return GoodputTrace(kind, rows)


def _lines(file: Path) -> Iterator[tuple[int, list[str]]]:
    """The number and the cells of each line."""
    text = read_named_text(file, most_bytes=_MOST_BYTES)
    for number, line in enumerate(itertools.islice(text.splitlines(), _MOST_ROWS), start=1):
        if line.strip() and not line.startswith("#"):
            try:
                yield number, [cell.strip() for cell in next(csv.reader([line]))]
            except csv.Error as error:
                raise _problem(
                    file, number, "", f"{error}: write the values with commas between them"
                ) from None


def _header(file: Path, first: tuple[int, list[str]], kinds: Sequence[tuple[str, ...]]) -> dict[str, int]:
    """The index of each column."""
    line, names = first
    columns = {name: index for index, name in enumerate(names)}
    if not any(set(kind) <= columns.keys() for kind in kinds):
        wanted = ", or ".join(" and ".join(kind) for kind in kinds)
        found = printable(", ".join(names), _LONGEST) or "nothing"
        raise _problem(file, line, "", f"the first line has {found}: name the columns {wanted}")
    return columns


def _cell(file: Path, line: int, row: list[str], columns: Mapping[str, int], name: str) -> str:
    if columns[name] >= len(row):
        raise _problem(file, line, name, f"missing in a line of {len(row)} values: add it")
    return row[columns[name]]


def _number(file: Path, line: int, name: str, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    least = -_LARGEST if name in _SIGNED else 0.0
    if not least <= number <= _LARGEST:
        expected = "a number" if name in _SIGNED else "a number of at least 0"
        raise _problem(file, line, name, f"{printable(cell, _LONGEST)!r}: expected {expected}")
    return number


def _problem(file: Path, line: int, column: str, problem: str) -> ConfigError:
    return ConfigError(str(file), ", ".join(filter(None, (f"line {line}", column))), problem)
