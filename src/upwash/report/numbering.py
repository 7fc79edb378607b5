"""One number for each finding, of one flight or of a fleet, and what was found in a sentence."""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import TypeAlias

from upwash.core.camera.catalogue import Catalogue, Shift, Sighting
from upwash.core.camera.georeference import Place
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.eventlog.objects import FAULTS, count_of_kind
from upwash.report.findings import Finding
from upwash.report.reviews import NO_REVIEWS, Review, Reviews, Verdict
from upwash.support.text import counted

_RESULT = ""  # the label of what has none
_MOST_KINDS = 6
_Key: TypeAlias = tuple[int, int]  # of a finding: its flight and its place there


@dataclass(frozen=True, slots=True)
class FlightFindings:
    """What was found on one flight, whose log has that name; before the mission began the drone is None.

    `opened` is the time of day at second 0 of the log, None for a simulated flight; `began_s` the mission's start in
    seconds of the log.
    """

    log: str
    drone: str | None
    opened: datetime | None
    began_s: float
    home: GeoPosition | None
    found: Sequence[Finding]
    reviews: Reviews = NO_REVIEWS

    def time_of_day(self, at_s: float) -> datetime | None:
        """The time of day (UTC) at that second of the log, None if unknown."""
        if self.opened is None:
            return None
        try:
            return self.opened.astimezone(UTC) + timedelta(seconds=at_s)
        except OverflowError:
            return None


@dataclass(frozen=True, slots=True)
class PlacedFinding:
    """An object, or a result without one, under its number: the same on map, photo, list and in every file.

    `finding` is the surest of its `sightings`, on `flight`, with the place by all of them. `best` says where that
    sighting stands, the index of its flight and of the finding there; `first` says the same of the first sighting.
    `reviews` are those of all sightings, in their order.
    """

    number: int
    flight: FlightFindings
    finding: Finding
    sightings: int = 1
    best: _Key = (0, 0)
    first: _Key = (0, 0)
    reviews: Sequence[Review] = ()

    @property
    def review(self) -> Review | None:
        """The last review, which counts; None for a finding without reviews."""
        return self.reviews[-1] if self.reviews else None

    @property
    def is_reviewed(self) -> bool:
        """Whether it is accepted or rejected."""
        return self.review is not None and self.review.is_decided

    @property
    def is_accepted(self) -> bool:
        """Whether it is accepted."""
        return self.review is not None and self.review.verdict is Verdict.ACCEPTED

    @property
    def is_rejected(self) -> bool:
        """Whether it is rejected."""
        return self.review is not None and self.review.verdict is Verdict.REJECTED

    @property
    def note(self) -> str:
        """The note of the last review."""
        return self.review.note if self.review else ""

    def sighting(self, finding: Finding) -> Finding:
        """One of its sightings, under the label that the last review gave."""
        label = self.review.label if self.review else ""
        return finding.labelled(label) if label else finding

    @property
    def verdicts(self) -> Mapping[str, Review]:
        """The last review of each reviewer, by the name, of those that have decided."""
        last = {review.reviewer: review for review in self.reviews}
        return {name: review for name, review in last.items() if review.is_decided}

    @property
    def is_disputed(self) -> bool:
        """Whether reviewers have decided about it in different ways."""
        return len({(review.verdict, review.label) for review in self.verdicts.values()}) > 1

    @property
    def mission_s(self) -> float:
        """When the message was sent, in seconds of the mission."""
        return self.finding.at_s - self.flight.began_s

    @property
    def time(self) -> datetime | None:
        """The time of day of the message, None if unknown."""
        return self.flight.time_of_day(self.finding.at_s)

    @property
    def earth(self) -> tuple[float, float] | None:
        """Latitude and longitude of the finding's place in degrees; None where home is not known."""
        return self.finding.earth(self.flight.home)


@dataclass(frozen=True, slots=True)
class Numbered:
    """Findings of flights as objects, in the order of their numbers.

    `positions` has the place of each finding's object among `objects`, by flight.
    """

    objects: Sequence[PlacedFinding]
    positions: Sequence[Sequence[int]]


def are_a_fleet(drones: Sequence[str | None]) -> bool:
    """Whether flights of these drones are of several; those that have yet to begin at once are taken for that."""
    return len(drones) > 1 and (len(set(drones)) > 1 or None in drones)


def numbered(flights: Sequence[FlightFindings]) -> Numbered:
    """The findings of the flights as objects under numbers from 1, in the order of their first messages.

    The findings of a fleet are one list, and an object that several drones saw has one number. The findings of one
    drone's flights are numbered for each flight.
    """
    if are_a_fleet([flight.drone for flight in flights]):
        return _numbered(flights)
    objects, positions = list[PlacedFinding](), list[Sequence[int]]()
    for index, part in enumerate(_numbered([flight]) for flight in flights):
        positions += [[len(objects) + position for position in own] for own in part.positions]
        objects += [
            replace(found, best=(index, found.best[1]), first=(index, found.first[1]))
            for found in part.objects
        ]
    return Numbered(objects, positions)


def _numbered(flights: Sequence[FlightFindings]) -> Numbered:
    order = list(heapq.merge(*map(_told_at, flights, range(len(flights)))))
    groups = _groups(flights, [(flight, index) for _, flight, index in order])
    positions = [[0] * len(flight.found) for flight in flights]
    objects = []
    for position, (keys, place) in enumerate(groups):
        for flight, index in keys:
            positions[flight][index] = position
        best = max(keys, key=lambda key: sureness(flights[key[0]].found[key[1]]))
        finding = flights[best[0]].found[best[1]]
        if place is not None:
            east_m, north_m = offset_m(flights, best[0])
            finding = replace(finding, own=place.moved(-east_m, -north_m))
        objects.append(PlacedFinding(position + 1, flights[best[0]], finding, len(keys), best, keys[0]))
    return Numbered(objects, positions)


def _groups(
    flights: Sequence[FlightFindings], order: Sequence[_Key]
) -> list[tuple[list[_Key], Place | None]]:
    """The findings of each object in order, with its place in the first flight's frame if it has one of its own."""
    catalogue, alone = Catalogue(), list[tuple[list[_Key], Place | None]]()
    photos: dict[tuple[int, int], int] = {}
    for (flight, photo), keys in itertools.groupby(order, key=lambda key: _photo_of(flights, key)):
        offset = offset_m(flights, flight)
        sightings, corners = [], None
        for key in keys:
            finding = flights[flight].found[key[1]]
            if finding.own is None or finding.photo is None or photo is None:
                alone.append(([key], None))
                continue
            sightings.append(Sighting(key, finding.what, finding.own.moved(*offset)))
            corners = corners or finding.photo.corners_m
        if photo is not None:
            number = photos.setdefault((flight, photo), len(photos))
            moved = corners and [(east + offset[0], north + offset[1]) for east, north in corners]
            catalogue.take(number, sightings, moved)
    catalogue.settle()
    rank = {key: number for number, key in enumerate(order)}
    together = [
        (sorted((sighting.key for sighting in entry.sightings.values()), key=rank.__getitem__), entry.place())
        for entry in catalogue.entries
    ]
    return sorted([*alone, *together], key=lambda group: rank[group[0][0]])


def _photo_of(flights: Sequence[FlightFindings], key: _Key) -> tuple[int, int | None]:
    photo = flights[key[0]].found[key[1]].photo
    return key[0], photo.number if photo else None


def offset_m(flights: Sequence[FlightFindings], flight: int) -> Shift:
    """Where the flight's home lies, east and north of the first flight's; nowhere else if one is unknown."""
    first, own = flights[0].home, flights[flight].home
    if first is None or own is None or first == own:
        return 0.0, 0.0
    position = LocalFrame(first).position(own)
    return position.east_m, position.north_m


def sureness(finding: Finding) -> tuple[float, float]:
    """What orders the sightings of an object: the score, and then the error."""
    return finding.score or 0.0, -(finding.error_m or 0.0)


def _told_at(flight: FlightFindings, index: int) -> Iterator[tuple[float, int, int]]:
    """The time of each of the flight's findings, the flight's index, and the finding's."""
    opened_s = flight.opened.timestamp() if flight.opened else 0.0
    latest_s = -float("inf")
    for number, finding in enumerate(flight.found):
        latest_s = max(latest_s, opened_s + finding.at_s)  # a clock's step back leaves a log in its order
        yield latest_s, index, number


def what_was_found(findings: Iterable[Finding]) -> str:
    """Such as "12 faults: 7 hot-spots, 5 broken modules", "2 hot-spots" or "1 finding"; empty where nothing is."""
    kinds = Counter(finding.box.label if finding.box else _RESULT for finding in findings)
    if not kinds:
        return ""
    if len(kinds) == 1:
        ((label, number),) = kinds.items()
        return counted(number, "finding") if label == _RESULT else count_of_kind(label, number)
    shown = [kind for kind in kinds.most_common() if kind[0] != _RESULT][:_MOST_KINDS]
    parts = [count_of_kind(label, number) for label, number in shown]
    if results := kinds[_RESULT]:
        parts.append(counted(results, "result"))
    if others := kinds.total() - results - sum(number for _, number in shown):
        parts.append(f"{others} of other kinds")
    noun = "fault" if kinds.keys() <= FAULTS.keys() else "finding"
    return f"{counted(kinds.total(), noun)}: {', '.join(parts)}"
