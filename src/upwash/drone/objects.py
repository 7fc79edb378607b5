"""The objects that a flight has found: findings of its answers that lie within their stated error of each other.

    an answer     Each finding gets a place by the photo of its call, and joins an object (core/camera/catalogue.py).
    a claim       The mission will act on the object: no other finding of the object is claimed.
    an act        The place is that of all findings until then. Objects that were joined meanwhile have one act.

An object is known by the keys of its findings, as the catalogue may join two objects later. In the mission's thread,
or while that waits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import msgspec

from upwash.core.camera.catalogue import Catalogue, Sighting
from upwash.core.camera.georeference import Place, Unplaced, radius_of_95
from upwash.core.geo import Position, rounded
from upwash.drone.answered_photos import NumberedPhoto
from upwash.eventlog.objects import Outline, found_objects
from upwash.eventlog.schema import FoundRecord

Key: TypeAlias = tuple[int, int]  # of a finding: its photo, and its number
_MOST_OBJECTS = 1000  # of an answer


@dataclass(frozen=True, slots=True)
class FoundObject:
    """An object on the ground, by all photos of this flight that show it until now.

    `score` is its best one. `place` is None where no photo tells it. `position` is over the object, at the altitude
    of its first photo; without a place it is where that photo was taken.
    """

    label: str
    score: float | None
    place: Place | None
    position: Position
    sightings: int

    def over(self, altitude_m: float) -> Position:
        """The position over the object, at an altitude above the ground there."""
        ground_m = self.place.position.altitude_m if self.place else 0.0
        return self.position.at_altitude(ground_m + altitude_m)


@dataclass(frozen=True, slots=True)
class AnsweredObject:
    """One object of an answer: its outline, its place on the photo if that is known, and where the drone was."""

    key: Key
    outline: Outline
    place: Place | None
    taken_at: Position


@dataclass(frozen=True, slots=True)
class Claim:
    """An object for an act of the mission: its number in the flight, and the finding that was claimed."""

    number: int
    key: Key


class ActOnObject(Protocol):
    """An act on an object, which is over with the answers of the calls that it leaves open."""

    object: int | None  # its number

    def begin_call(self) -> None:
        """Note that the act has left a call open."""

    def end_call(self, answer: Any, photo: NumberedPhoto | None) -> None:
        """Take the answer of that call, None if it has failed."""


class FlightObjects:
    """Joins the findings of one flight, and knows which objects the mission acts on, or has acted on.

    `acted_on` are objects of the same mission before it was resumed, and `last` is the highest of their numbers.
    `acting` is the act that is under way, None between acts.
    """

    def __init__(self, acted_on: Sequence[FoundRecord] = (), *, last: int = 0) -> None:
        self._catalogue = Catalogue()
        self._is_joined = True  # no entries of the catalogue can be joined any more
        self._findings: dict[Key, AnsweredObject] = {}
        self._claimed = set[Key]()
        self._keys = itertools.count()
        self._numbers = itertools.count(last + 1)
        self.acting: ActOnObject | None = None
        for photo, record in enumerate(acted_on, start=1):
            at, variance_m2, apart_m = record.place, record.variance_m2, record.apart_m
            if at is not None and variance_m2 is not None and apart_m is not None:
                place = Place(at, radius_of_95(variance_m2), variance_m2, apart_m)
                outline = Outline(0.0, 0.0, 0.0, 0.0, record.label, record.score)
                finding = AnsweredObject((-photo, next(self._keys)), outline, place, place.position)
                self._join(-photo, [finding], None)
                self._claimed.add(finding.key)

    @property
    def under_way(self) -> int | None:
        """The number of the object that has an act now; None between acts."""
        return self.acting.object if self.acting is not None else None

    def take(self, answer: object, photo: NumberedPhoto | None, taken_at: Position) -> list[AnsweredObject]:
        """The findings of an answer to a photo, which join the objects."""
        number, geometry = (photo.number, photo.geometry) if photo else (-1, None)
        outlines = found_objects(msgspec.to_builtins(answer, enc_hook=repr)) or []
        sight = geometry.sight if geometry else Unplaced("")
        findings = []
        for outline in outlines[:_MOST_OBJECTS]:
            place = sight if isinstance(sight, Unplaced) else sight.place_of(*outline.middle_and_size)
            known = None if isinstance(place, Unplaced) else place
            findings.append(AnsweredObject((number, next(self._keys)), outline, known, taken_at))
        corners = geometry.footprint_m() if geometry else None
        self._join(number, findings, corners)
        return findings

    def claim(
        self, findings: Sequence[AnsweredObject], wanted: Callable[[FoundObject], object]
    ) -> Iterator[Claim]:
        """Claim each object of these findings that is wanted and not claimed; without places one of them at most."""
        placed = [finding for finding in findings if finding.place and not self._is_claimed(finding.key)]
        if placed:
            self._join_entries()
        for finding in placed:
            if not self._is_claimed(finding.key) and wanted(self.found(finding.key)):
                yield self._claim(finding)
        alone = (finding for finding in findings if finding.place is None)
        if (first := next((each for each in alone if wanted(self.found(each.key))), None)) is not None:
            yield self._claim(first)

    def is_alone(self, claim: Claim) -> bool:
        """Whether no other claim is of the same object, as far as is known by now."""
        if self._findings[claim.key].place is not None:
            self._join_entries()
        return not self._is_claimed(claim.key, but=claim.key)

    def release_if_joined(self, claim: Claim) -> None:
        """Forget the claim if its object has another claim; else the object stays claimed."""
        if not self.is_alone(claim):
            self._claimed.discard(claim.key)

    def found(self, key: Key) -> FoundObject:
        """The object of a finding, by all photos until now."""
        finding = self._findings[key]
        if finding.place is None:
            label, score = finding.outline.label, finding.outline.score
            return FoundObject(label, score, None, finding.taken_at, 1)
        entry = self._catalogue.entry_of(*key)
        place = entry.place()
        scores = [self._findings[seen.key].outline.score for seen in entry.sightings.values()]
        return FoundObject(
            label=finding.outline.label,
            score=max((score for score in scores if score is not None), default=None),
            place=place,
            position=place.position.at_altitude(finding.taken_at.altitude_m),
            sightings=len(scores),
        )

    def record(self, claim: Claim) -> FoundRecord:
        """The claimed object, for the log."""
        found = self.found(claim.key)
        place = found.place
        return FoundRecord(
            number=claim.number,
            label=found.label,
            score=found.score,
            place=rounded(place.position) if place else None,
            variance_m2=place.variance if place else None,
            apart_m=place.apart_m if place else None,
        )

    def _claim(self, finding: AnsweredObject) -> Claim:
        self._claimed.add(finding.key)
        return Claim(next(self._numbers), finding.key)

    def _join(
        self, photo: int, findings: Sequence[AnsweredObject], corners: Sequence[tuple[float, float]] | None
    ) -> None:
        self._findings |= {finding.key: finding for finding in findings}
        sightings = [Sighting(each.key, each.outline.label, each.place) for each in findings if each.place]
        self._catalogue.take(photo, sightings, corners)
        self._is_joined = False

    def _join_entries(self) -> None:
        if not self._is_joined:
            self._is_joined = not self._catalogue.join()

    def _is_claimed(self, key: Key, *, but: Key | None = None) -> bool:
        is_placed = self._findings[key].place is not None
        keys = (
            [seen.key for seen in self._catalogue.entry_of(*key).sightings.values()] if is_placed else [key]
        )
        return not self._claimed.isdisjoint(each for each in keys if each != but)
