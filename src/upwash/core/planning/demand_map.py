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

from upwash.core.geo import Grid, Placed, Position, Waypoint, ground_distance_m

_SAME_M = 2.0  # answers within this distance count for one place
_LEAST_NEAR_M = 10.0
_REACH = 3.0  # times `near`, where an answer's weight is 1 %; farther answers do not count
_EVERYWHERE = 2.0  # answers that the chance everywhere counts for
_FADES = 0.5  # with each flight


@dataclass(slots=True)
class DemandPlace(Placed):
    """Answers to photos of one place, and the demands among them; fractions, as earlier flights count less."""

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
        self._places = Grid(known, side_m=_REACH * near_m)
        answers = sum(place.answers for place in self.places())
        demands = sum(place.demands for place in self.places())
        self.before = (demands + 1) / (answers + 4)  # the chance everywhere, before the flight

    def places(self) -> Iterator[DemandPlace]:
        """Every place with an answer."""
        return iter(self._places)

    def note(self, position: Position, *, demanded: bool) -> None:
        """Add an answer to a photo of the position."""
        for place in self._places.around(position, squares=0):
            if ground_distance_m(place.position, position) <= _SAME_M:
                place.answers += 1
                place.demands += demanded
                place.flights_ago = 0
                return
        self._places.add(DemandPlace(position, 1.0, float(demanded)))

    def chance(self, position: Position, everywhere: float) -> float:
        """The chance of a demand at the position, from 0 to 1, where `everywhere` holds for the whole flight."""
        answers, demands = _EVERYWHERE, _EVERYWHERE * everywhere
        for place in self._places.around(position):
            away = ground_distance_m(place.position, position) / self._near_m
            if away <= _REACH:
                weight = math.exp(-away * away / 2)
                answers += weight * place.answers
                demands += weight * place.demands
        return demands / answers


def near_m(plan: Sequence[Waypoint]) -> float:
    """How far away an answer still says much: as far as two waypoints of the plan lie apart, but at least 10 m."""
    ways_m = [ground_distance_m(one.position, other.position) for one, other in itertools.pairwise(plan)]
    return max(_LEAST_NEAR_M, median(ways_m)) if ways_m else _LEAST_NEAR_M
