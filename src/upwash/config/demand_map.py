"""The file that keeps, between flights, the places of answers with demands."""

from __future__ import annotations

from collections.abc import Sequence
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
from upwash.core.planning.demand_map import DemandMap, DemandPlace

_Answers = Annotated[float, Meta(ge=0, le=1e9)]


class _Place(Struct, forbid_unknown_fields=True):
    east_m: Metres
    north_m: Metres
    answers: _Answers
    demands: _Answers
    flights_ago: Count = 0


class _Map(Struct, forbid_unknown_fields=True):
    upwash_demands: Literal[1]
    home: Home | None = None
    places: Annotated[Sequence[_Place], Meta(max_length=MOST_PLACES)] = ()


class DemandFile(KeptMap):
    """A map of demands and its file; a missing file is an empty map."""

    def __init__(self, file: Path) -> None:
        self._map = read_kept(file, _Map, empty=_Map(upwash_demands=1), name="map of demands")
        super().__init__(file, self._map, self._map.home)

    @property
    def is_empty(self) -> bool:
        """Whether no flight has had an answer yet."""
        return not self._map.places

    def places(self, home: GeoPosition | None) -> list[DemandPlace]:
        """The places of earlier flights' answers around that home, at the beginning of the next flight."""
        its_home = shift(self._map.home, home)
        return [
            DemandPlace(
                Position(place.east_m + its_home.east_m, place.north_m + its_home.north_m),
                answers=place.answers,
                demands=min(place.demands, place.answers),
                flights_ago=place.flights_ago,
            ).faded()
            for place in self._map.places
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
        write_kept(self.file, _Map(upwash_demands=1, home=home_of(home), places=places))
