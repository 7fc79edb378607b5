"""The file that keeps, between flights, what a drone measured at each place of servers without a range.

The file is JSON, so that people can read and mend it. Its positions are relative to its own home: a later mission may
have another home.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.core.knowledge.coverage import MOST_PLACES, Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import WINDOW_LENGTH
from upwash.core.operation import Operation
from upwash.errors import ConfigError
from upwash.support.input_files import read_file, text_of, why_unreadable
from upwash.support.output_files import write_file

FORGOTTEN_AFTER = 5  # flights: a place that never answered is tried again after them

_MOST_BYTES = 50_000_000
_Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
_Count = Annotated[int, Meta(ge=0, le=2**53)]
_Amount = Annotated[float, Meta(ge=0, le=1e18)]
_Seconds = Annotated[float, Meta(ge=0, le=1e6)]


class _Calls(Struct, forbid_unknown_fields=True):
    service: str
    method: str
    key: str
    came_to_s: Annotated[Sequence[_Seconds], Meta(min_length=1, max_length=WINDOW_LENGTH)]


class _Place(Struct, forbid_unknown_fields=True):
    east_m: _Metres
    north_m: _Metres
    tried: _Count
    answered: _Count
    bits: _Amount = 0.0
    transfer_s: _Amount = 0.0
    flights_ago: _Count = 0
    calls: Sequence[_Calls] = ()


class _Home(Struct, forbid_unknown_fields=True):
    latitude_deg: Annotated[float, Meta(ge=-90, le=90)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]


class _Map(Struct, forbid_unknown_fields=True):
    upwash_coverage: Literal[1]
    home: _Home | None = None
    servers: Mapping[str, Annotated[Sequence[_Place], Meta(max_length=MOST_PLACES)]] = {}


class CoverageFile:
    """A coverage map and its file; a missing file is an empty map."""

    # No dataclass: msgspec would look for its fields in the configuration instead of asking how to read it.

    def __init__(self, file: Path) -> None:
        self.file = file
        self._map = _read(file)

    @property
    def is_empty(self) -> bool:
        """Whether no flight has measured a place yet."""
        return not any(self._map.servers.values())

    @property
    def has_home(self) -> bool:
        """Whether the map knows where on the Earth its places are."""
        return self._map.home is not None

    def places(self, home: GeoPosition | None) -> dict[str, list[MeasuredPlace]]:
        """What earlier flights measured of each server, around that home; new values at each call."""
        shift = _shift(self._map.home, home)
        return {
            server: [_place(place, shift) for place in places] for server, places in self._map.servers.items()
        }

    def keep(self, coverage: Coverage, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Servers that were not measured keep their places; places that no flight has measured for long are forgotten.
        """
        former = self.places(home)
        kept = {server: list(coverage.places(server)) for server in coverage.servers}
        content = _Map(
            upwash_coverage=1,
            home=None if home is None else _Home(home.latitude_deg, home.longitude_deg),
            servers={
                server: [_entry(place) for place in places if place.flights_ago <= FORGOTTEN_AFTER]
                for server, places in (former | kept).items()
            },
        )
        write_file(self.file, msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n")


def _read(file: Path) -> _Map:
    try:
        return msgspec.json.decode(text_of(read_file(file, most_bytes=_MOST_BYTES)), type=_Map)
    except FileNotFoundError:
        return _Map(upwash_coverage=1)
    except msgspec.MsgspecError as error:
        problem = f"no coverage map of upwash: {error}: restore the file, or delete it to begin anew"
        raise ConfigError(str(file), "", problem) from None
    except (OSError, ValueError) as error:
        problem = f"cannot be read ({why_unreadable(error)}): name a readable file"
        raise ConfigError(str(file), "", problem) from None


def _shift(before: _Home | None, home: GeoPosition | None) -> Position:
    """The position of the file's home, from the mission's home."""
    if before is None or home is None:
        return Position(0.0, 0.0)
    return LocalFrame(home).position(GeoPosition(before.latitude_deg, before.longitude_deg))


def _place(entry: _Place, shift: Position) -> MeasuredPlace:
    return MeasuredPlace(
        Position(entry.east_m + shift.east_m, entry.north_m + shift.north_m),
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
