"""One object, one entry: which sightings on overlapping photos are of the same object.

The places of a photo are off together, by the errors of its position and tilt. So the catalogue lays each photo over
the entries with a shift of its own. At each candidate a box meets an entry. The most probable shift wins, by the
product of these:

- a box on an entry: a normal distribution of their distance
- a box on no entry: the density of objects on the ground
- an entry in view without a box: the share of objects that a detector misses
- the shift: a normal distribution of the error of the pose

Places, shifts and corners are complex numbers here: east and north.

Two boxes of a photo are never one object, and neither are two labels. `settle` then moves photos and entries to where
all photos agree best, and joins entries that no photo shows together although both were in view. During a flight
`join` does the latter alone.
"""

from __future__ import annotations

import math
import operator
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from upwash.core.camera.georeference import Place
from upwash.core.geo import Position

_CELL_M = 4.0
_MISSED = 0.15  # of the objects in view
_ALONE = 0.3  # of the photos of an object do not show its neighbour
_GATE = 3.5  # standard errors
_JITTER_M = 0.35  # of a place within its photo, beside its stated error
_MOST_SHIFTS = 6
_EDGE = 0.04  # of the photo's size: what lies nearer to its edge may have no box
_ROUNDS, _SWEEPS = 4, 4
_UNSEEN_M2 = 400.0  # the ground of a photo whose corners are unknown

Shift = tuple[float, float]
Corners = Sequence[tuple[float, float]]


@dataclass(slots=True)
class Sighting:
    """A box of a photo on the ground; `key` is its caller's. `own_m` is its standard error in a shifted photo."""

    key: tuple[int, int]
    label: str
    place: Place
    at: complex = field(init=False)
    own_m: float = field(init=False)

    def __post_init__(self) -> None:
        self.at = complex(self.place.position.east_m, self.place.position.north_m)
        self.own_m = math.hypot(self.place.apart_m, _JITTER_M)


@dataclass(slots=True)
class Exposure:
    """A photo as it lies over the entries, and the standard error of the shift without any entry."""

    shift: complex
    spread_m: float
    seen: list[tuple[Sighting, Entry]] = field(default_factory=list)


@dataclass(slots=True)
class Entry:
    """An object: where it lies among the entries, and its sightings by photo."""

    label: str
    at: complex
    sightings: dict[int, Sighting] = field(default_factory=dict)

    def place(self) -> Place:
        """The mean of the sightings' places by their variances. Its error takes the photos' errors for the same."""
        places = [sighting.place for sighting in self.sightings.values()]
        weights = [1 / max(1e-6, place.variance[0] + place.variance[2]) for place in places]
        total = sum(weights)

        def mean(values: Iterable[float]) -> float:
            return sum(weight * value for weight, value in zip(weights, values, strict=True)) / total

        surest = min(places, key=lambda place: place.error_m)
        position = Position(
            mean(place.position.east_m for place in places),
            mean(place.position.north_m for place in places),
            mean(place.position.altitude_m for place in places),
        )
        return replace(surest, position=position, error_m=mean(place.error_m for place in places))


class Catalogue:
    """The objects of a survey; photos come in the order of their times."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self._photos: dict[int, Exposure] = {}
        self._cells: dict[tuple[str, int, int], list[Entry]] = defaultdict(list)
        self._labels = set[str]()
        self._boxes, self._area_m2 = 1.0, _UNSEEN_M2

    def take(self, photo: int, sightings: Sequence[Sighting], corners: Corners | None) -> None:
        """Takes in the sightings on a photo, a later message about the same photo too."""
        if not sightings:
            return
        outline = [complex(*corner) for corner in corners or ()]
        self._boxes += len(sightings)
        self._area_m2 += _area_m2(outline) if outline else _UNSEEN_M2
        near = []  # the entries that each sighting may be of
        for sighting in sightings:
            reach_m = _GATE * (math.sqrt(2 * _variance_m2(sighting)) + _JITTER_M)
            within = self._within(sighting.label, sighting.at, reach_m)
            near.append([entry for entry in within if photo not in entry.sightings])
        spread_m = math.sqrt(sum(_variance_m2(sighting) for sighting in sightings) / len(sightings))
        shift, pairs = 0j, dict[int, Entry]()
        if any(near):
            expected = self._in_view(photo, outline) if outline else []
            shift, pairs = self._best(sightings, near, expected, spread_m)
        exposure = self._photos.setdefault(photo, Exposure(shift, spread_m))
        for index, sighting in enumerate(sightings):
            entry = pairs.get(index)
            if entry is None:
                entry = Entry(sighting.label, sighting.at + shift)
                self.entries.append(entry)
                self._labels.add(entry.label)
                self._cell(entry).append(entry)
            entry.sightings[photo] = sighting
            exposure.seen.append((sighting, entry))
            self._relax(entry)

    def settle(self) -> None:
        """Moves photos and entries to where all photos agree best, and joins entries of one object."""
        for _ in range(_ROUNDS):
            for _ in range(_SWEEPS):
                for exposure in self._photos.values():
                    exposure.shift = _shrunk(exposure.seen, exposure.spread_m)
                self._centre()
                for entry in self.entries:
                    self._relax(entry)
            if not self.join():
                return

    def join(self) -> int:
        """Joins entries that are more probably one object than two; returns how many."""
        of_none = math.log(self._boxes / self._area_m2)
        found = []
        for number, entry in enumerate(self.entries):
            own_m = self._error_m(entry)
            for other in self._within(entry.label, entry.at, 2 * _GATE * own_m):
                if other is entry or not entry.sightings.keys().isdisjoint(other.sightings):
                    continue
                spread_m = math.hypot(own_m, self._error_m(other))
                away_m = abs(entry.at - other.at)
                value = _log_normal(away_m, spread_m) - of_none
                value -= min(len(entry.sightings), len(other.sightings)) * math.log(_ALONE)
                if value > 0 and away_m < _GATE * spread_m:
                    found.append((-value, number, entry, other))
        gone = set[int]()
        for _, _, entry, other in sorted(found, key=lambda pair: pair[:2]):
            if id(entry) in gone or id(other) in gone:
                continue
            if not entry.sightings.keys().isdisjoint(other.sightings):
                continue
            for photo, sighting in other.sightings.items():
                exposure = self._photos[photo]
                exposure.seen = [(seen, entry if seen is sighting else its) for seen, its in exposure.seen]
            entry.sightings |= other.sightings
            self._cell(other).remove(other)
            gone.add(id(other))
        self.entries = [entry for entry in self.entries if id(entry) not in gone]
        return len(gone)

    def entry_of(self, photo: int, number: int) -> Entry:
        """The object of the sighting on that photo whose key is (photo, number)."""
        key = photo, number
        return next(entry for seen, entry in self._photos[photo].seen if seen.key == key)

    # --- a photo over the entries ---

    def _best(
        self,
        sightings: Sequence[Sighting],
        near: Sequence[Sequence[Entry]],
        expected: Sequence[Entry],
        spread_m: float,
    ) -> tuple[complex, dict[int, Entry]]:
        """The most probable shift, and the pairs of sightings and entries there."""
        best: tuple[float, complex, dict[int, Entry]] = (-math.inf, 0j, {})
        of_none = math.log(self._boxes / self._area_m2)
        for start in _shifts(sightings, near):
            pairs = _pairs(sightings, near, start)
            shift = _shrunk([(sightings[index], entry) for index, entry in pairs.items()], spread_m)
            value = -(shift.real**2 + shift.imag**2) / (4 * spread_m**2)  # of the photo and of the entries
            for index, sighting in enumerate(sightings):
                entry = pairs.get(index)
                away_m = abs(entry.at - sighting.at - shift) if entry is not None else 0.0
                value += of_none if entry is None else _log_normal(away_m, sighting.own_m)
            met = {id(entry) for entry in pairs.values()}
            value += math.log(_MISSED) * sum(id(entry) not in met for entry in expected)
            if value > best[0]:
                best = value, shift, pairs
        return best[1], best[2]

    def _in_view(self, photo: int, corners: Sequence[complex]) -> list[Entry]:
        """The entries well within the photo's corners."""
        middle = sum(corners) / len(corners)
        inner = [middle + (1 - 2 * _EDGE) * (corner - middle) for corner in corners]
        reach_m = max(abs(corner - middle) for corner in inner)
        return [
            entry
            for label in self._labels
            for entry in self._within(label, middle, reach_m)
            if photo not in entry.sightings and _is_inside(entry, inner)
        ]

    def _within(self, label: str, at: complex, reach_m: float) -> Iterator[Entry]:
        if (reach_m / _CELL_M) ** 2 > len(self._cells):
            yield from (entry for entry in self.entries if entry.label == label)
            return
        columns = range(_cell(at.real - reach_m), _cell(at.real + reach_m) + 1)
        for row in range(_cell(at.imag - reach_m), _cell(at.imag + reach_m) + 1):
            for column in columns:
                if entries := self._cells.get((label, column, row)):
                    yield from entries

    def _cell(self, entry: Entry) -> list[Entry]:
        return self._cells[entry.label, _cell(entry.at.real), _cell(entry.at.imag)]

    # --- photos and entries together ---

    def _relax(self, entry: Entry) -> None:
        """Moves the entry to the mean of its sightings."""
        self._cell(entry).remove(entry)
        weights = [1 / sighting.own_m**2 for sighting in entry.sightings.values()]
        places = [self._photos[photo].shift + sighting.at for photo, sighting in entry.sightings.items()]
        entry.at = sum(map(operator.mul, weights, places), 0j) / sum(weights)
        self._cell(entry).append(entry)

    def _centre(self) -> None:
        """Takes from each shift what the photos around have in common: reported places are right on average."""
        common = {
            id(entry): sum(self._photos[photo].shift for photo in entry.sightings) / len(entry.sightings)
            for entry in self.entries
        }
        for exposure in self._photos.values():
            exposure.shift -= sum(common[id(entry)] for _, entry in exposure.seen) / len(exposure.seen)

    def _error_m(self, entry: Entry) -> float:
        """The standard error of the entry among entries of other photos: those photos may all be off together."""
        certainty = sum(
            1 / (sighting.own_m**2 + self._photos[photo].spread_m ** 2)
            for photo, sighting in entry.sightings.items()
        )
        return max(_JITTER_M, 1 / math.sqrt(certainty))


def _shifts(sightings: Sequence[Sighting], near: Sequence[Sequence[Entry]]) -> list[complex]:
    """The shifts that most boxes would agree on, and none at all."""
    votes: dict[tuple[int, int], list[complex]] = defaultdict(list)
    for sighting, entries in zip(sightings, near, strict=True):
        for entry in entries:
            apart = entry.at - sighting.at
            votes[round(apart.real), round(apart.imag)].append(apart)
    ranked = sorted(votes.values(), key=lambda found: (-len(found), abs(found[0])))[:_MOST_SHIFTS]
    return [0j, *(sum(found) / len(found) for found in ranked)]


def _pairs(
    sightings: Sequence[Sighting], near: Sequence[Sequence[Entry]], shift: complex
) -> dict[int, Entry]:
    """The nearest pairs at that shift, each sighting and each entry in one at most."""
    distances = []
    for index, (sighting, entries) in enumerate(zip(sightings, near, strict=True)):
        at, reach_m = sighting.at + shift, _GATE * sighting.own_m
        for number, entry in enumerate(entries):
            if (away_m := abs(entry.at - at)) <= reach_m:
                distances.append((away_m / reach_m, index, number))
    pairs, taken = dict[int, Entry](), set[int]()
    for _, index, number in sorted(distances):
        entry = near[index][number]
        if index not in pairs and id(entry) not in taken:
            pairs[index] = entry
            taken.add(id(entry))
    return pairs


def _shrunk(pairs: Sequence[tuple[Sighting, Entry]], spread_m: float) -> complex:
    """The mean shift from the sightings to their entries, less what the pose makes improbable."""
    total, shift = spread_m**-2, 0j
    for sighting, entry in pairs:
        weight = 1 / sighting.own_m**2
        total += weight
        shift += weight * (entry.at - sighting.at)
    return shift / total


def _variance_m2(sighting: Sighting) -> float:
    variance = sighting.place.variance
    return max(0.01, (variance[0] + variance[2]) / 2)


def _log_normal(away_m: float, spread_m: float) -> float:
    """The logarithm of the density of a normal distribution of the plane."""
    return -((away_m / spread_m) ** 2) / 2 - math.log(math.tau * spread_m**2)


def _cell(length_m: float) -> int:
    return math.floor(length_m / _CELL_M)


def _area_m2(corners: Sequence[complex]) -> float:
    return abs(sum((corner.conjugate() * other).imag for corner, other in _sides(corners)) / 2)


def _is_inside(entry: Entry, corners: Sequence[complex]) -> bool:
    """Whether the entry lies within the corners, which are clockwise."""
    return all(
        ((entry.at - corner) * (other - corner).conjugate()).imag <= 0 for corner, other in _sides(corners)
    )


def _sides(corners: Sequence[complex]) -> Iterator[tuple[complex, complex]]:
    return zip(corners, [*corners[1:], corners[0]], strict=True)
