"""What the client's document is about: flights, their photos, and objects with the sightings that show each best."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TypeAlias

from upwash.core.camera.georeference import Ground
from upwash.eventlog import schema
from upwash.report.findings import Finding, TakenPhoto
from upwash.report.numbering import PlacedFinding, are_a_fleet, offset_m, sureness
from upwash.report.record import Record, reviewed_of
from upwash.report.reviewed import ReviewTally
from upwash.support.text import clock

PhotoKey: TypeAlias = tuple[int, int]  # the flight, and the photo's number there


@dataclass(frozen=True, slots=True)
class Photograph:
    """A photo of a flight; `time` is the time of day at the shutter, None if unknown.

    `corners_m` are its corners on the ground, east and north of the flight's home, None if unknown.
    """

    key: PhotoKey
    taken: TakenPhoto
    mission_s: float
    time: datetime | None
    corners_m: Sequence[tuple[float, float]] | None


@dataclass(frozen=True, slots=True)
class SurveyFlight:
    """A flight: what its log tells, the vehicle, "" if unknown, and the photos."""

    record: Record
    vehicle: str
    photographs: Sequence[Photograph]


@dataclass(frozen=True, slots=True)
class ShownSighting:
    """A sighting of an object, the photo that it is on, and what the document calls it."""

    finding: Finding
    photo: PhotoKey
    title: str = ""


@dataclass(frozen=True, slots=True)
class Inspected:
    """An object under the name that it has in the document, and the looks at it, the surest first, two at most."""

    name: str
    found: PlacedFinding
    looks: Sequence[ShownSighting]


@dataclass(frozen=True, slots=True)
class Survey:
    """The flights, and what was found on them: under one list of numbers, or flight by flight.

    `tally` says how much of it was reviewed.
    """

    flights: Sequence[SurveyFlight]
    objects: Sequence[Inspected]
    with_findings: Set[PhotoKey]  # the photos
    are_one_list: bool
    tally: ReviewTally

    @property
    def photographs(self) -> list[Photograph]:
        """The photos of all flights."""
        return [photo for flight in self.flights for photo in flight.photographs]

    @property
    def knows_the_ground(self) -> bool:
        """Whether places are on a terrain, and not on level ground."""
        geometries = (photo.taken.geometry for photo in self.photographs)
        return any(each is not None and each.ground != Ground() for each in geometries)

    def named(self, key: PhotoKey) -> str:
        """Which photo that is, and when it was taken."""
        photo = self.flights[key[0]].photographs[key[1]]
        flight = f"flight {key[0] + 1}, " if len(self.flights) > 1 else ""
        time = f"{photo.time:%H:%M:%S}" if photo.time else clock(photo.mission_s)
        return f"{flight}photo {key[1] + 1}, {time}"

    def taken(self, key: PhotoKey) -> str:
        """The same, and from what altitude."""
        place = self.flights[key[0]].photographs[key[1]].taken.shot.position
        return self.named(key) + ("" if place is None else f", from {place.altitude_m:.0f} m")

    def corners_m(self, photo: Photograph, first: int) -> list[tuple[float, float]]:
        """The photo's corners on the ground, east and north of that flight's home; none if unknown."""
        east_m, north_m = self.offset_m(photo.key[0], first)
        return [(east + east_m, north + north_m) for east, north in photo.corners_m or ()]

    def offset_m(self, flight: int, first: int) -> tuple[float, float]:
        """Where the flight's home lies, east and north of another flight's."""
        return offset_m([self.flights[first].record.flight, self.flights[flight].record.flight], 1)


def survey_of(records: Sequence[Record]) -> Survey:
    """The flights of these records as the client's document tells them, without rejected findings."""
    found = reviewed_of(records)
    are_one_list = len(records) == 1 or are_a_fleet([flight.drone for flight in found.flights])
    looks: dict[int, list[ShownSighting]] = defaultdict(list)
    with_findings = set[PhotoKey]()
    for number, flight in enumerate(found.flights):
        for finding, position in zip(flight.found, found.positions[number], strict=True):
            of = found.everything[position]
            if finding.photo is None or of.is_rejected:
                continue
            with_findings.add((number, finding.photo.number))
            if finding.box is not None:
                looks[position].append(ShownSighting(of.sighting(finding), (number, finding.photo.number)))
    flown = [_flown(number, record) for number, record in enumerate(records)]
    again = {photo.key for flight in flown for photo in flight.photographs if photo.taken.is_again}
    objects = []
    for position, of in enumerate(found.everything):
        if not of.is_rejected:
            name = str(of.number) if are_one_list else f"{of.best[0] + 1}-{of.number}"
            objects.append(Inspected(name, of, _best_looks(looks[position], again)))
    return Survey(flown, objects, with_findings, are_one_list, found.tally)


def _best_looks(sightings: Sequence[ShownSighting], again: Set[PhotoKey]) -> list[ShownSighting]:
    """The surest sighting, and the surest on a photo taken `again` from lower down, or else on another photo."""
    surest = sorted(sightings, key=lambda look: sureness(look.finding), reverse=True)
    seconds = [look for look in surest if look.photo in again]
    first = next((look for look in surest if look.photo not in again), surest[0] if surest else None)
    if first is None:
        return []
    looks = [replace(first, title="The surest sighting")]
    if seconds and first.photo not in again:
        return [*looks, replace(seconds[0], title="The second look")]
    others = [look for look in surest if look.photo != first.photo]
    return [*looks, *(replace(look, title="Another sighting") for look in others[:1])]


def _flown(index: int, record: Record) -> SurveyFlight:
    found = [event for event in record.events if isinstance(event, schema.VehicleFound)]
    vehicle = f"{found[-1].firmware} {found[-1].type}" if found else ""
    photographs, flight = [], record.flight
    for taken, event in record.photos:
        taken_s = event.t - event.age_s
        key, time = (index, taken.number), flight.time_of_day(taken_s)
        photographs.append(Photograph(key, taken, taken_s - record.began_s, time, taken.corners_m))
    return SurveyFlight(record, vehicle, photographs)
