"""What the client's document is about: flights, their photos, and objects with the sightings that show each best."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TypeAlias

from upwash.core.camera.georeference import Ground
from upwash.eventlog import schema
from upwash.eventlog.progress import clock
from upwash.report.findings import Finding, Pairing, TakenPhoto
from upwash.report.numbering import PlacedFinding, are_a_fleet, numbered, offset_m, sureness
from upwash.report.record import Record

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
class Flown:
    """A flight: what its log tells, the vehicle, "" if unknown, and the photos."""

    record: Record
    vehicle: str
    photographs: Sequence[Photograph]


@dataclass(frozen=True, slots=True)
class Look:
    """A sighting of an object, the photo that it is on, and what the document calls it."""

    finding: Finding
    photo: PhotoKey
    title: str = ""


@dataclass(frozen=True, slots=True)
class Inspected:
    """An object under the name that it has in the document, and the looks at it, the surest first, two at most."""

    name: str
    found: PlacedFinding
    looks: Sequence[Look]


@dataclass(frozen=True, slots=True)
class Survey:
    """The flights, and what was found on them: under one list of numbers, or flight by flight."""

    flights: Sequence[Flown]
    objects: Sequence[Inspected]
    are_one_list: bool

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

    @property
    def with_findings(self) -> set[PhotoKey]:
        """The photos with findings."""
        return {
            (index, finding.photo.number)
            for index, flight in enumerate(self.flights)
            for finding in flight.record.findings
            if finding.photo is not None
        }

    def corners_m(self, photo: Photograph, first: int) -> list[tuple[float, float]]:
        """The photo's corners on the ground, east and north of that flight's home; none if unknown."""
        east_m, north_m = self.offset_m(photo.key[0], first)
        return [(east + east_m, north + north_m) for east, north in photo.corners_m or ()]

    def offset_m(self, flight: int, first: int) -> tuple[float, float]:
        """Where the flight's home lies, east and north of another flight's."""
        return offset_m([self.flights[first].record.found, self.flights[flight].record.found], 1)


def survey_of(records: Sequence[Record]) -> Survey:
    """The flights of these records as the client's document tells them."""
    flights = [record.found for record in records]
    found = numbered(flights)
    are_one_list = len(flights) == 1 or are_a_fleet([flight.drone for flight in flights])
    sightings: dict[tuple[int, int], list[Look]] = defaultdict(list)
    for flight, (each, numbers) in enumerate(zip(flights, found.numbers, strict=True)):
        for finding, number in zip(each.found, numbers, strict=True):
            if finding.photo is not None and finding.box is not None:
                key = 0 if are_one_list else flight, number
                sightings[key].append(Look(finding, (flight, finding.photo.number)))
    objects = []
    for placed in found.objects:
        flight, number = placed.best[0], placed.number
        name = str(number) if are_one_list else f"{flight + 1}-{number}"
        own = sightings[0 if are_one_list else flight, number]
        objects.append(Inspected(name, placed, _best_looks(own)))
    return Survey([_flown(index, record) for index, record in enumerate(records)], objects, are_one_list)


def _best_looks(sightings: Sequence[Look]) -> list[Look]:
    """The surest sighting, and the surest on another photo."""
    surest = sorted(sightings, key=lambda look: sureness(look.finding), reverse=True)
    others = [look for look in surest if look.photo != surest[0].photo]
    first = [replace(look, title="The surest sighting") for look in surest[:1]]
    return [*first, *(replace(look, title="Another sighting") for look in others[:1])]


def _flown(index: int, record: Record) -> Flown:
    pairing, vehicle = Pairing(), ""
    photographs = []
    for event in record.events:
        pairing.take(event)
        if isinstance(event, schema.VehicleFound):
            vehicle = f"{event.firmware} {event.type}"
        elif isinstance(event, schema.PhotoTaken) and (taken := pairing.last) is not None:
            taken_s = event.t - event.age_s
            key = index, taken.number
            time = record.found.time_of_day(taken_s)
            photographs.append(Photograph(key, taken, taken_s - record.began_s, time, taken.corners_m))
    return Flown(record, vehicle, photographs)
