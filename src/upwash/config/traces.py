"""Traces in CSV files, for simulations: what was measured of servers, links and flights.

The first line names the columns. A line that begins with # is left out.

    service_csv   operation, seconds             a call draws one of its operation's times, with the scenario's seed
    goodput_csv   t_s, bit_s                     from that time of the simulation on, until the next row
                  distance_m, bit_s              straight between the rows, and nothing beyond the last
                  east_m, north_m, bit_s         of the nearest row
    track_csv     t_s, a place                   the place at that time after the take-off, straight between the rows
    wind_csv      t_s, east_m_s, north_m_s       likewise, where the air moves to
    battery_csv   t_s, percent                   likewise, the charge
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

from upwash.core.geo import GeoPosition, LocalFrame
from upwash.errors import ConfigError
from upwash.support.input_files import read_named_text
from upwash.support.text import named_twice, number_of, printable

_MOST_BYTES = 50_000_000
_MOST_LINES = 1_000_000
_LONGEST = 60  # characters of a value that is quoted
_LARGEST = 1e15
_Kinds = tuple[tuple[str, ...], ...]
Stamp = tuple[int, int]
_GOODPUT: _Kinds = (("t_s", "bit_s"), ("distance_m", "bit_s"), ("east_m", "north_m", "bit_s"))
_TRACK: _Kinds = (
    ("t_s", "east_m", "north_m", "altitude_m"),
    ("t_s", "latitude_deg", "longitude_deg", "altitude_m"),
    ("t_s", "east_m", "north_m"),
    ("t_s", "latitude_deg", "longitude_deg"),
)
_WIND: _Kinds = (("t_s", "east_m_s", "north_m_s"),)
_BATTERY: _Kinds = (("t_s", "percent"),)
_ASCENDING = ("t_s", "distance_m")
_SIGNED = dict.fromkeys(("east_m", "north_m", "altitude_m"), _LARGEST) | {
    "latitude_deg": 90.0,
    "longitude_deg": 180.0,
    "east_m_s": 100.0,
    "north_m_s": 100.0,
}
_MOST = {"percent": 100.0}
_LONGEST_GAP_S, _SAME_PLACE_M, _FASTEST_M_S = 30.0, 5.0, 100.0  # of a track


class Trace(Struct, frozen=True):
    """The numbers of the `columns`; `rows` are in the file's order, and `lines` has the line of each."""

    columns: tuple[str, ...]
    rows: Sequence[tuple[float, ...]]
    lines: Sequence[int] = ()


def read_service_times(file: Path) -> Mapping[str, Sequence[float]]:
    """The times (s) of each operation, named as in the file; raises ConfigError with the line and the column."""
    return _service_times(file, stamp_of(file))


@lru_cache
def _service_times(file: Path, _stamp: Stamp) -> Mapping[str, Sequence[float]]:
    times: dict[str, list[float]] = defaultdict(list)
    _, rows = _table(file, (("operation", "seconds"),))
    for line, cells in rows:
        operation, seconds = cells
        if not operation:
            raise _problem(
                file, line, "operation", 'empty: name an operation, such as "detector.process_photo[heavy]"'
            )
        times[operation].append(_number(file, line, "seconds", seconds))
    if not times:
        raise ConfigError(str(file), "", "no rows: add one for each measured call, operation and seconds")
    return {operation: tuple(seconds) for operation, seconds in times.items()}


def read_goodput_trace(file: Path) -> Trace:
    """The goodput in bit/s by time, distance or place; raises ConfigError with the line and the column."""
    trace = _read(file, stamp_of(file), _GOODPUT)
    if not any(row[-1] for row in trace.rows):
        raise ConfigError(
            str(file), "", "nothing gets through in any row: give a bit_s above 0 in one of them"
        )
    return trace


def read_track(file: Path, frame: LocalFrame | None) -> Trace:
    """The places in metres by the time, the altitude last; without a column for it in the file, without one.

    Degrees are placed by `frame`. Raises ConfigError with the line and the column.
    """
    trace = _read(file, stamp_of(file), _TRACK)
    if "latitude_deg" in trace.columns:
        if frame is None:
            raise ConfigError(
                str(file), "", "its degrees need mission.home: add it, or give east_m and north_m"
            )
        places = [frame.position(GeoPosition(row[1], row[2])) for row in trace.rows]
        rows = [(row[0], at.east_m, at.north_m, *row[3:]) for row, at in zip(trace.rows, places, strict=True)]
        trace = Trace(("t_s", "east_m", "north_m", *trace.columns[3:]), rows, trace.lines)
    for line, (before, row) in zip(trace.lines[1:], itertools.pairwise(trace.rows), strict=True):
        lasts_s, way_m = row[0] - before[0], math.dist(before[1:], row[1:])
        if lasts_s > _LONGEST_GAP_S and way_m > _SAME_PLACE_M:
            raise _problem(
                file, line, "t_s", f"a gap of {lasts_s:g} s: add the places between, or cut the file here"
            )
        if way_m > _FASTEST_M_S * lasts_s:
            raise _problem(
                file,
                line,
                trace.columns[1],
                f"{way_m:.0f} m in {lasts_s:g} s: give metres, or degrees, and seconds",
            )
    if len(trace.rows) < 2:
        raise ConfigError(str(file), "", "one row is no flight: add the places that follow")
    return trace


def read_wind(file: Path) -> Trace:
    """The wind over the ground by the time; raises ConfigError with the line and the column."""
    return _read(file, stamp_of(file), _WIND)


def read_battery(file: Path) -> Trace:
    """The charge in percent by the time; raises ConfigError with the line and the column."""
    return _read(file, stamp_of(file), _BATTERY)


def stamp_of(file: Path) -> Stamp:
    """What changes with the file's content; a file with changed content is read again."""
    try:
        found = file.stat()
    except OSError:  # which reading it reports
        return (0, 0)
    return found.st_mtime_ns, found.st_size


@lru_cache
def _read(file: Path, _stamp: Stamp, kinds: _Kinds) -> Trace:
    kind, table = _table(file, kinds)
    rows: list[tuple[float, ...]] = []
    lines: list[int] = []
    for line, cells in table:
        rows.append(tuple(_number(file, line, name, cell) for name, cell in zip(kind, cells, strict=True)))
        lines.append(line)
        if kind[0] in _ASCENDING and len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise _problem(
                file, line, kind[0], f"{rows[-1][0]:g} follows {rows[-2][0]:g}: let the values ascend"
            )
    if not rows:
        raise ConfigError(str(file), "", f"no rows: add some, with the columns {' and '.join(kind)}")
    return Trace(kind, rows, lines)


def _lines(file: Path) -> Iterator[tuple[int, list[str]]]:
    text = read_named_text(file, most_bytes=_MOST_BYTES)
    for number, line in enumerate(text.splitlines(), start=1):
        if number > _MOST_LINES:
            raise ConfigError(
                str(file), "", f"more than {_MOST_LINES:,} lines: leave rows out, such as every second one"
            )
        if line.strip() and not line.startswith("#"):
            try:
                yield number, [cell.strip() for cell in next(csv.reader([line]))]
            except csv.Error as error:
                raise _problem(
                    file, number, "", f"{error}: write the values with commas between them"
                ) from None


def _table(file: Path, kinds: _Kinds) -> tuple[tuple[str, ...], Iterator[tuple[int, Iterator[str]]]]:
    """The first kind of columns that the file has, and of each line the number and the cells in those columns."""
    lines = _lines(file)
    line, names = next(lines, (1, []))
    kind = next((kind for kind in kinds if set(kind) <= set(names)), None)
    if kind is None:
        wanted = ", or ".join(" and ".join(kind) for kind in kinds)
        found = printable(", ".join(names), _LONGEST) or "nothing"
        raise _problem(file, line, "", f"the first line has {found}: name the columns {wanted}")
    if twice := named_twice(names):
        raise _problem(file, line, printable(twice, _LONGEST), "two columns have this name: leave one out")

    def cells(line: int, row: list[str]) -> Iterator[str]:
        for name in kind:
            if names.index(name) >= len(row):
                raise _problem(file, line, name, f"missing in a line of {len(row)} values: add it")
            yield row[names.index(name)]

    return kind, ((line, cells(line, row)) for line, row in lines)


def _number(file: Path, line: int, name: str, cell: str) -> float:
    try:
        number = number_of(cell)
    except ValueError:
        number = math.nan
    most = _SIGNED.get(name, _MOST.get(name, _LARGEST))
    least = -most if name in _SIGNED else 0.0
    if least <= number <= most:
        return number
    expected = "a number" if name in _SIGNED else "a number of at least 0"
    if most < _LARGEST:
        expected = f"a number from {least:g} to {most:g}"
    raise _problem(file, line, name, f"{printable(cell, _LONGEST)!r}: expected {expected}")


def _problem(file: Path, line: int, column: str, problem: str) -> ConfigError:
    return ConfigError(str(file), ", ".join(filter(None, (f"line {line}", column))), problem)
