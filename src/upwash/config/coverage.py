"""The file that keeps, between flights, what a drone measured at each place of servers without a range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from upwash.config.kept_places import FORGOTTEN_AFTER, MOST_FIELDS, Count, Home, KeptMap, home_of, moved
from upwash.core.geo import MOST_PLACES, GeoPosition, Metres, Position
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import WINDOW_LENGTH
from upwash.core.operation import Operation

# No flight bounds how long a call may take, so a smaller bound would refuse maps that upwash itself writes.
_Amount = Annotated[float, Meta(ge=0, le=1e18)]


class _Calls(Struct, forbid_unknown_fields=True):
    service: str
    method: str
    key: str
    came_to_s: Annotated[Sequence[_Amount], Meta(min_length=1, max_length=WINDOW_LENGTH)]


class _Place(Struct, forbid_unknown_fields=True):
    east_m: Metres
    north_m: Metres
    tried: Count
    answered: Count
    bits: _Amount = 0.0
    transfer_s: _Amount = 0.0
    flights_ago: Count = 0
    calls: Sequence[_Calls] = ()


_Servers = Mapping[str, Annotated[Sequence[_Place], Meta(max_length=MOST_PLACES)]]


class _Field(Struct, forbid_unknown_fields=True):
    home: Home | None = None
    servers: _Servers = {}


class _File(Struct, forbid_unknown_fields=True):
    upwash_coverage: Literal[1]
    home: Home | None = None
    servers: _Servers = {}
    elsewhere: Annotated[Sequence[_Field], Meta(max_length=MOST_FIELDS)] = ()


class CoverageFile(KeptMap[_Field]):
    """A coverage map and its file."""

    def __init__(self, file: Path) -> None:
        super().__init__(file, _fields, mark="upwash_coverage", name="coverage map")

    def places(self, home: GeoPosition | None) -> dict[str, list[MeasuredPlace]]:
        """What earlier flights measured of each server, around that home; new values at each call."""
        found: dict[str, list[MeasuredPlace]] = {}
        for field, its_home in self._around(home):
            for server, places in field.servers.items():
                known = found.setdefault(server, [])
                known += (place for entry in places if (place := _place(entry, its_home)) is not None)
        return found

    def keep(self, coverage: Coverage, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Servers that were not measured keep their places; places that no flight has measured for long are forgotten.
        """
        former = self.places(home)
        kept = {server: list(coverage.places(server)) for server in coverage.servers}
        servers = {
            server: [_entry(place) for place in places if place.flights_ago <= FORGOTTEN_AFTER][:MOST_PLACES]
            for server, places in (former | kept).items()
        }
        self._write(_File(1, home_of(home), servers, self._elsewhere(home)))


def _fields(text: str) -> list[_Field]:
    file = msgspec.json.decode(text, type=_File)
    return [_Field(file.home, file.servers), *file.elsewhere]


def _place(entry: _Place, home: Position) -> MeasuredPlace | None:
    position = moved(entry.east_m, entry.north_m, home)
    return (
        None
        if position is None
        else MeasuredPlace(
            position,
            tried=max(entry.tried, entry.answered),
            answered=entry.answered,
            bits=entry.bits,
            transfer_s=entry.transfer_s,
            flights_ago=entry.flights_ago + 1,
            came_to_s={
                Operation(calls.service, calls.method, calls.key): tuple(calls.came_to_s)
                for calls in entry.calls
            },
        )
    )


def _entry(place: MeasuredPlace) -> _Place:
    return _Place(
        east_m=round(place.position.east_m, 2),
        north_m=round(place.position.north_m, 2),
        tried=place.tried,
        answered=place.answered,
        bits=place.bits,
        transfer_s=round(place.transfer_s, 4),
        flights_ago=place.flights_ago,
        calls=[
            _Calls(
                operation.service,
                operation.method,
                operation.key,
                [round(delay_s, 4) for delay_s in came_to_s],
            )
            for operation, came_to_s in place.came_to_s.items()
        ],
    )
