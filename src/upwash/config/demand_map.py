"""The file that keeps, between flights, the places of answers with demands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from upwash.config.kept_places import FORGOTTEN_AFTER, MOST_FIELDS, Count, Home, KeptMap, home_of, moved
from upwash.core.geo import MOST_PLACES, GeoPosition, Metres
from upwash.core.planning.demand_map import DemandMap, DemandPlace

_Answers = Annotated[float, Meta(ge=0, le=1e9)]


class _Place(Struct, forbid_unknown_fields=True):
    east_m: Metres
    north_m: Metres
    answers: _Answers
    demands: _Answers
    flights_ago: Count = 0


_Places = Annotated[Sequence[_Place], Meta(max_length=MOST_PLACES)]


class _Field(Struct, forbid_unknown_fields=True):
    home: Home | None = None
    places: _Places = ()


class _File(Struct, forbid_unknown_fields=True):
    upwash_demands: Literal[1]
    home: Home | None = None
    places: _Places = ()
    elsewhere: Annotated[Sequence[_Field], Meta(max_length=MOST_FIELDS)] = ()


class DemandFile(KeptMap[_Field]):
    """A map of demands and its file."""

    def __init__(self, file: Path) -> None:
        super().__init__(file, _fields, mark="upwash_demands", name="map of demands")

    def places(self, home: GeoPosition | None) -> list[DemandPlace]:
        """The places of earlier flights' answers around that home, at the beginning of the next flight."""
        return [
            DemandPlace(
                position,
                answers=place.answers,
                demands=min(place.demands, place.answers),
                flights_ago=place.flights_ago,
            ).faded()
            for field, its_home in self._around(home)
            for place in field.places
            if (position := moved(place.east_m, place.north_m, its_home)) is not None
        ]

    def keep(self, known: DemandMap, home: GeoPosition | None) -> None:
        """Write the map after a flight from that home; raises NotWritten.

        Places that no flight had an answer from for five flights are forgotten.
        """
        places = [
            _Place(
                round(place.position.east_m, 2),
                round(place.position.north_m, 2),
                round(place.answers, 4),
                round(place.demands, 4),
                place.flights_ago,
            )
            for place in known.places()
            if place.flights_ago <= FORGOTTEN_AFTER
        ]
        self._write(_File(1, home_of(home), places, self._elsewhere(home)))


def _fields(text: str) -> list[_Field]:
    file = msgspec.json.decode(text, type=_File)
    return [_Field(file.home, file.places), *file.elsewhere]
