"""The file that keeps, between flights, what a drone measured at each place of servers without a range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from upwash.config.kept_places import (
    FORGOTTEN_AFTER,
    Count,
    Home,
    KeptMap,
    Metres,
    home_of,
    read_kept,
    shift,
    write_kept,
)
from upwash.core.geo import MOST_PLACES, GeoPosition, Position
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import WINDOW_LENGTH
from upwash.core.operation import Operation

_Amount = Annotated[float, Meta(ge=0, le=1e18)]
_Seconds = Annotated[float, Meta(ge=0, le=1e6)]


class _Calls(Struct, forbid_unknown_fields=True):
    service: str
    method: str
    key: str
    came_to_s: Annotated[Sequence[_Seconds], Meta(min_length=1, max_length=WINDOW_LENGTH)]


class _Place(Struct, forbid_unknown_fields=True):
    east_m: Metres
    north_m: Metres
    tried: Count
    answered: Count
    bits: _Amount = 0.0
    transfer_s: _Amount = 0.0
    flights_ago: Count = 0
    calls: Sequence[_Calls] = ()


class _Map(Struct, forbid_unknown_fields=True):
    upwash_coverage: Literal[1]
    home: Home | None = None
    servers: Mapping[str, Annotated[Sequence[_Place], Meta(max_length=MOST_PLACES)]] = {}


class CoverageFile(KeptMap):
    """A coverage map and its file; a missing file is an empty map."""

    def __init__(self, file: Path) -> None:
        self._map = read_kept(file, _Map, empty=_Map(upwash_coverage=1), name="coverage map")
        super().__init__(file, self._map, self._map.home)

    @property
    def is_empty(self) -> bool:
        """Whether no flight has measured a place yet."""
        return not any(self._map.servers.values())

    def places(self, home: GeoPosition | None) -> dict[str, list[MeasuredPlace]]:
        """What earlier flights measured of each server, around that home; new values at each call."""
        its_home = shift(self._map.home, home)
        return {
            server: [_place(place, its_home) for place in places]
            for server, places in self._map.servers.items()
        }

    def keep(self, coverage: Coverage, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Servers that were not measured keep their places; places that no flight has measured for long are forgotten.
        """
        former = self.places(home)
        kept = {server: list(coverage.places(server)) for server in coverage.servers}
        content = _Map(
            upwash_coverage=1,
            home=home_of(home),
            servers={
                server: [_entry(place) for place in places if place.flights_ago <= FORGOTTEN_AFTER]
                for server, places in (former | kept).items()
            },
        )
        write_kept(self.file, content)


def _place(entry: _Place, home: Position) -> MeasuredPlace:
    return MeasuredPlace(
        Position(entry.east_m + home.east_m, entry.north_m + home.north_m),
        tried=max(entry.tried, entry.answered),
        answered=entry.answered,
        bits=entry.bits,
        transfer_s=entry.transfer_s,
        flights_ago=entry.flights_ago + 1,
        came_to_s={
            Operation(calls.service, calls.method, calls.key): tuple(calls.came_to_s) for calls in entry.calls
        },
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
