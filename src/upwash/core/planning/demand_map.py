"""Where answers had demands, on this flight and on earlier ones: the chance of a demand at a place.

    chance = (the sum of w * demands + 2 q) / (the sum of w * answers + 2)

over the places within three times `near`. w = exp(-(r / near)² / 2) by the distance r, and q is the chance that
holds everywhere. Answers of earlier flights count half as much after each flight.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median

from upwash.core.geo import Position, Waypoint, ground_distance_m

MOST_PLACES = 5_000  # of a map; what lies longest without an answer makes room
_SAME_M = 2.0  # answers within this distance count for one place
_LEAST_NEAR_M = 10.0
_REACH = 3.0  # times `near`, where an answer's weight is 1 %; farther answers do not count
_EVERYWHERE = 2.0  # answers that the chance everywhere counts for
_FADES = 0.5  # with each flight


@dataclass(frozen=True, slots=True)
class DemandPlace:
    """Answers to photos of one place, and the demands among them; fractions, as earlier flights count less."""

    position: Position
    answers: float
    demands: float
    flights_ago: int = 0

    def faded(self) -> DemandPlace:
        """The place at the beginning of the next flight."""
        return replace(
            self,
            answers=_FADES * self.answers,
            demands=_FADES * self.demands,
            flights_ago=self.flights_ago + 1,
        )


class DemandMap:
    """The places of answers around a plan; an answer `near_m` away still says much."""

    def __init__(self, known: Iterable[DemandPlace], *, near_m: float) -> None:
        self._near_m = near_m
        self._squares: dict[tuple[int, int], list[DemandPlace]] = {}
        self._count = 0
        for place in known:
            self._keep(place)
        answers = sum(place.answers for place in self.places())
        demands = sum(place.demands for place in self.places())
        self.before = (demands + 1) / (answers + 4)  # the chance everywhere, before the flight

    def places(self) -> Iterator[DemandPlace]:
        """Every place with an answer."""
        for square in self._squares.values():
            yield from square

    def note(self, position: Position, *, demanded: bool) -> None:
        """Add an answer to a photo of the position."""
        square = self._squares.get(self._square(position), [])
        for number, place in enumerate(square):
            if ground_distance_m(place.position, position) <= _SAME_M:
                square[number] = replace(
                    place, answers=place.answers + 1, demands=place.demands + demanded, flights_ago=0
                )
                return
        self._keep(DemandPlace(position, 1.0, float(demanded)))

    def chance(self, position: Position, everywhere: float) -> float:
        """The chance of a demand at the position, from 0 to 1, where `everywhere` holds for the whole flight."""
        answers, demands = _EVERYWHERE, _EVERYWHERE * everywhere
        east, north = self._square(position)
        for square in ((east + x, north + y) for x in (-1, 0, 1) for y in (-1, 0, 1)):
            for place in self._squares.get(square, ()):
                away = ground_distance_m(place.position, position) / self._near_m
                if away <= _REACH:
                    weight = math.exp(-away * away / 2)
                    answers += weight * place.answers
                    demands += weight * place.demands
        return demands / answers

    def _keep(self, place: DemandPlace) -> None:
        if self._count >= MOST_PLACES:
            oldest = next(iter(self._squares))
            self._squares[oldest].pop(0)
            self._count -= 1
            if not self._squares[oldest]:
                del self._squares[oldest]
        self._squares.setdefault(self._square(place.position), []).append(place)
        self._count += 1

    def _square(self, position: Position) -> tuple[int, int]:
        side_m = _REACH * self._near_m
        return math.floor(position.east_m / side_m), math.floor(position.north_m / side_m)


def near_m(plan: Sequence[Waypoint]) -> float:
    """How far away an answer still says much: as far as two waypoints of the plan lie apart, but at least 10 m."""
    ways_m = [ground_distance_m(one.position, other.position) for one, other in itertools.pairwise(plan)]
    return max(_LEAST_NEAR_M, median(ways_m)) if ways_m else _LEAST_NEAR_M
