"""The files that keep, between flights, what was found at places: JSON around homes.

People can read and mend the files. Positions are relative to a home, and the field around each home keeps its own: a
mission elsewhere leaves what was found here as it is. A file that was damaged since it was written is put aside.
"""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from upwash.config.values import HomeConfig, NamedFile
from upwash.core.geo import (
    FARTHEST_M,
    MOST_PLACES,
    GeoPosition,
    LocalFrame,
    Metres,
    Position,
    ground_distance_m,
)
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import WINDOW_LENGTH
from upwash.core.operation import Operation
from upwash.core.planning.demand_map import DemandMap, DemandPlace
from upwash.errors import ConfigError, NotWritten
from upwash.support.input_files import read_file, text_of, why_unreadable
from upwash.support.output_files import write_file

FORGOTTEN_AFTER = 5  # flights without a visit, after which a place is forgotten

_MOST_FIELDS = 100  # elsewhere; those where no flight was for longest are forgotten
_FIELD_M = 10_000.0  # between homes of one field, where the plane of positions is true to 0.1 %
_MOST_BYTES = 50_000_000
_Count = Annotated[int, Meta(ge=0, le=2**53)]
# No flight bounds how long a call may take, so a smaller bound would refuse maps that upwash itself writes.
_Amount = Annotated[float, Meta(ge=0, le=1e18)]
_Answers = Annotated[float, Meta(ge=0, le=1e9)]
T = TypeVar("T")


class _KeptMap(NamedFile, Generic[T]):
    """The fields of a file, the latest first: each has a home, or none, and what was found around it.

    A missing file and a damaged one have no field. Raises ConfigError for a file that cannot be read, or that never
    was what it must be.
    """

    _name: str
    _mark: str  # the file's first key
    _found: str  # the key of what was found
    _content: type[Any]

    def __init__(self, file: Path) -> None:
        super().__init__(file)
        self._fields, self._damage = self._read()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _KeptMap) and (self.file, self._fields) == (other.file, other._fields)

    def __hash__(self) -> int:
        return hash(self.file)

    @property
    def notice(self) -> str:
        """What becomes of a damaged file; "" for any other."""
        if not self._damage:
            return ""
        return (
            f"{self.file} is a damaged {self._name} ({self._damage}): the flight begins an empty one, and its end "
            f"renames the damaged file {_aside(self.file).name}"
        )

    def _around(self, home: GeoPosition | None) -> Iterator[tuple[T, Position]]:
        for its_home, found in self._fields:
            if (at := _shift(its_home, home)) is not None:
                yield found, at

    def _write(self, home: GeoPosition | None, found: T) -> None:
        """Write what the file keeps, without the oldest fields if it would be too large; raises NotWritten."""
        here = {self._mark: 1, "home": home and HomeConfig.at(home), self._found: found}
        elsewhere = [
            {"home": its_home, self._found: its}
            for its_home, its in self._fields
            if _shift(its_home, home) is None
        ][:_MOST_FIELDS]
        while len(encoded := _encoded(here | {"elsewhere": elsewhere})) >= _MOST_BYTES:
            if not elsewhere:
                raise NotWritten(self.file, OSError(errno.EFBIG, os.strerror(errno.EFBIG)), "it is unchanged")
            elsewhere.pop()
        try:
            if self._read()[1]:
                self.file.rename(_aside(self.file))
        except (OSError, ConfigError) as error:
            problem = error if isinstance(error, OSError) else OSError(errno.EINVAL, str(error))
            raise NotWritten(self.file, problem, "it is unchanged") from error
        write_file(self.file, encoded + b"\n")

    def _read(self) -> tuple[list[tuple[HomeConfig | None, T]], str]:
        content = b""
        try:
            content = read_file(self.file, most_bytes=_MOST_BYTES)
            kept = msgspec.json.decode(text_of(content), type=self._content)
            return [(field.home, getattr(field, self._found)) for field in (kept, *kept.elsewhere)], ""
        except FileNotFoundError:
            return [], ""
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            written = content.strip(b"\0")  # a power cut leaves zeros
            begins, ours = b"".join(written[:100].split()), f'{{"{self._mark}":'.encode()
            if begins.startswith(ours) or ours.startswith(begins):
                return [], str(error) if written else "nothing is in it"
            problem = f"no {self._name} of upwash: {error}: restore the file, or delete it to begin anew"
        except (OSError, ValueError) as error:
            why = why_unreadable(error)
            problem = f"cannot be read ({why}): name a readable file, or delete this one to begin anew"
        raise ConfigError(str(self.file), "", problem)


def _shift(before: HomeConfig | None, home: GeoPosition | None) -> Position | None:
    """The position of a field's home from the mission's home; None if it is elsewhere."""
    if before is None or home is None:
        return Position(0.0, 0.0) if before is None and home is None else None
    at = LocalFrame(home).position(before.place)
    return at if ground_distance_m(at, Position(0.0, 0.0)) <= _FIELD_M else None


def _encoded(content: object) -> bytes:
    return msgspec.json.format(msgspec.json.encode(content), indent=1)


def _aside(file: Path) -> Path:
    names = (file.with_name(f"{file.name}.damaged{number or ''}") for number in itertools.count())
    return next(name for name in names if not os.path.lexists(name))


class _Place(Struct, forbid_unknown_fields=True):
    east_m: Metres
    north_m: Metres

    def seen_from(self, field: Position) -> Position | None:
        """The place from the mission's home, with the field's home at `field`; None beyond the farthest position."""
        east_m, north_m = self.east_m + field.east_m, self.north_m + field.north_m
        return Position(east_m, north_m) if max(abs(east_m), abs(north_m)) <= FARTHEST_M else None


class _Demands(_Place, forbid_unknown_fields=True):
    answers: _Answers
    demands: _Answers
    flights_ago: _Count = 0


class _DemandField(Struct, forbid_unknown_fields=True):
    home: HomeConfig | None = None
    places: Annotated[Sequence[_Demands], Meta(max_length=MOST_PLACES)] = ()


class _DemandContent(_DemandField, kw_only=True, forbid_unknown_fields=True):
    upwash_demands: Literal[1]
    elsewhere: Annotated[Sequence[_DemandField], Meta(max_length=_MOST_FIELDS)] = ()


class DemandFile(_KeptMap[Sequence[_Demands]]):
    """A map of the places of answers with demands, and its file."""

    _name, _mark, _found, _content = "map of demands", "upwash_demands", "places", _DemandContent

    def places(self, home: GeoPosition | None) -> list[DemandPlace]:
        """The places of earlier flights' answers around that home, at the beginning of the next flight."""
        return [
            DemandPlace(at, place.answers, min(place.demands, place.answers), place.flights_ago).faded()
            for places, field in self._around(home)
            for place in places
            if (at := place.seen_from(field)) is not None
        ]

    def keep(self, known: DemandMap, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Places that no flight had an answer from for five flights are forgotten.
        """
        places = []
        for place in known.places():
            if place.flights_ago <= FORGOTTEN_AFTER:
                east_m, north_m = round(place.position.east_m, 2), round(place.position.north_m, 2)
                answers, demands = round(place.answers, 4), round(place.demands, 4)
                places.append(_Demands(east_m, north_m, answers, demands, place.flights_ago))
        self._write(home, places)


class _Calls(Struct, forbid_unknown_fields=True):
    service: str
    method: str
    key: str
    came_to_s: Annotated[Sequence[_Amount], Meta(min_length=1, max_length=WINDOW_LENGTH)]


class _Measured(_Place, forbid_unknown_fields=True):
    tried: _Count
    answered: _Count
    bits: _Amount = 0.0
    transfer_s: _Amount = 0.0
    flights_ago: _Count = 0
    calls: Sequence[_Calls] = ()


class _CoverageField(Struct, forbid_unknown_fields=True):
    home: HomeConfig | None = None
    servers: Mapping[str, Annotated[Sequence[_Measured], Meta(max_length=MOST_PLACES)]] = {}


class _CoverageContent(_CoverageField, kw_only=True, forbid_unknown_fields=True):
    upwash_coverage: Literal[1]
    elsewhere: Annotated[Sequence[_CoverageField], Meta(max_length=_MOST_FIELDS)] = ()


class CoverageFile(_KeptMap[Mapping[str, Sequence[_Measured]]]):
    """A coverage map, which has what a drone measured at each place of servers without a range, and its file."""

    _name, _mark, _found, _content = "coverage map", "upwash_coverage", "servers", _CoverageContent

    def places(self, home: GeoPosition | None) -> dict[str, list[MeasuredPlace]]:
        """What earlier flights measured of each server, around that home; new values at each call."""
        found: dict[str, list[MeasuredPlace]] = {}
        for servers, field in self._around(home):
            for server, places in servers.items():
                known = found.setdefault(server, [])
                known += (_place(each, at) for each in places if (at := each.seen_from(field)) is not None)
        return found

    def keep(self, coverage: Coverage, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Servers that were not measured keep their places; places that no flight has measured for long are forgotten.
        """
        kept = {server: list(coverage.places(server)) for server in coverage.servers}
        servers = {
            server: [_entry(place) for place in places if place.flights_ago <= FORGOTTEN_AFTER][:MOST_PLACES]
            for server, places in (self.places(home) | kept).items()
        }
        self._write(home, servers)


def _place(entry: _Measured, position: Position) -> MeasuredPlace:
    return MeasuredPlace(
        position,
        tried=max(entry.tried, entry.answered),
        answered=entry.answered,
        bits=entry.bits,
        transfer_s=entry.transfer_s,
        flights_ago=entry.flights_ago + 1,
        came_to_s={
            Operation(each.service, each.method, each.key): tuple(each.came_to_s) for each in entry.calls
        },
    )


def _entry(place: MeasuredPlace) -> _Measured:
    calls = [
        _Calls(each.service, each.method, each.key, [round(delay_s, 4) for delay_s in came_to_s])
        for each, came_to_s in place.came_to_s.items()
    ]
    return _Measured(
        east_m=round(place.position.east_m, 2),
        north_m=round(place.position.north_m, 2),
        tried=place.tried,
        answered=place.answered,
        bits=place.bits,
        transfer_s=round(place.transfer_s, 4),
        flights_ago=place.flights_ago,
        calls=calls,
    )
