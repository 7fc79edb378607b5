"""The findings in the messages to a drone's user, each with its photo and its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from sys import intern

import msgspec

from upwash.core.camera.georeference import PhotoGeometry, Place, Sight, Unplaced
from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.eventlog import schema
from upwash.eventlog.narration import in_one_line
from upwash.eventlog.objects import Outline, found_objects
from upwash.eventlog.schema import Event
from upwash.report.photos import Shot
from upwash.report.reviews import FindingKey
from upwash.support.text import printable

MOST_PICTURED = 60  # findings on a report's page
OF_DRONE = "the drone's place when the photo was taken"
OF_MISSION = "the place that the mission named"
OF_OBJECT = "the object's own place"
_NO_LENS = "the camera's lens is unknown"
_LONGEST_WORDS = 300  # characters
_MOST_REMEMBERED = 10_000  # photos of a run


@dataclass(frozen=True, slots=True)
class TakenPhoto:
    """The `number`th photo of a run, counted from 0, and the waypoint where it was taken, None before the first.

    `earth` is the latitude and longitude of the drone then, None where the log has none; `geometry` decides where
    lies what the photo shows, None for a camera whose lens is unknown. `is_again` marks a second look at an object.
    """

    number: int
    shot: Shot
    waypoint: int | None
    earth: tuple[float, float] | None = None
    geometry: PhotoGeometry | None = None
    is_again: bool = False

    @property
    def corners_m(self) -> list[tuple[float, float]] | None:
        """The photo's corners on the ground, east and north of home; None if unknown."""
        return self.geometry.footprint_m() if self.geometry else None


def _on_earth(latitude_deg: float | None, longitude_deg: float | None) -> tuple[float, float] | None:
    """The place, None if it does not exist: a log may have any numbers."""
    if latitude_deg is None or longitude_deg is None or abs(latitude_deg) > 90 or abs(longitude_deg) > 360:
        return None
    return latitude_deg, longitude_deg


class Pairing:
    """Follows the events of a run: `told_of` is the photo that the last message to the user is about."""

    def __init__(self) -> None:
        self.last: TakenPhoto | None = None
        self.told_of: TakenPhoto | None = None
        self.here: int | None = None  # the last waypoint
        self._taken: dict[int, TakenPhoto] = {}  # by their numbers since the program began
        self._since_start = 0

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.Arrived(waypoint=waypoint):
                self.here = waypoint
            case schema.PhotoTaken(source=source, position=position):
                number = 0 if self.last is None else self.last.number + 1
                shot = Shot(source, position, self._since_start)
                earth = _on_earth(event.latitude_deg, event.longitude_deg)
                is_again = event.object is not None
                self.last = TakenPhoto(number, shot, self.here, earth, event.geometry, is_again)
                self._taken[self._since_start] = self.last
                self._taken.pop(self._since_start - _MOST_REMEMBERED, None)
                self._since_start += 1
            case schema.Notified(photo=number):
                self.told_of = self.last if number is None else self._taken.get(number)
            case schema.MissionStarted():
                self.here = None
            case schema.LogResumed():
                self._since_start = 0
                self._taken.clear()


@dataclass(frozen=True, slots=True)
class Finding:
    """One object in a message to the user, with its box; or a result without boxes. `at_s` is its second of the log.

    `named` is the place that the mission gave with the message, `photo` what the message is about, None before the
    first photo. `own` is where the object itself lies, None if unknown; `unplaced` says why. `message` is the number
    of the message in the run and `index` that of the object in the message, both counted from 0.
    """

    at_s: float
    what: str
    score: float | None
    waypoint: int | None
    named: Position
    box: Outline | None
    photo: TakenPhoto | None
    own: Place | None = None
    unplaced: str = ""
    message: int = 0
    index: int = 0

    @property
    def key(self) -> FindingKey:
        """What names it in reviews."""
        return FindingKey(self.at_s, self.message, self.index)

    def labelled(self, label: str) -> Finding:
        """The same finding under another label."""
        box = None if self.box is None else msgspec.structs.replace(self.box, label=label)
        return replace(self, what=label, box=box)

    @property
    def words(self) -> str:
        """What was found, and how sure that is."""
        return self.what if self.score is None else f"{self.what} {100 * self.score:.0f} %"

    @property
    def place(self) -> Position:
        """The best place that is known; `place_is` says what that place is."""
        return self._place[0]

    @property
    def place_is(self) -> str:
        """Of what `place` is the place."""
        return self._place[1]

    @property
    def error_m(self) -> float | None:
        """How far from `place` the object may lie, None where that is not known."""
        return self.own.error_m if self.own else None

    @property
    def _place(self) -> tuple[Position, str]:
        if self.own is not None:
            return self.own.position, OF_OBJECT + (
                f", assuming {self.own.assumes}" if self.own.assumes else ""
            )
        taken_at = self.photo.shot.position if self.box is not None and self.photo is not None else None
        if taken_at is None:
            return self.named, OF_MISSION
        return taken_at, OF_DRONE + (f": {self.unplaced}" if self.unplaced else "")

    def earth(self, home: GeoPosition | None) -> tuple[float, float] | None:
        """Latitude and longitude of `place` in degrees; None where home is not known."""
        is_of_drone = self.own is None and self.box is not None and self.photo is not None
        if is_of_drone and self.photo is not None and self.photo.earth is not None:
            return self.photo.earth
        if home is None:
            return None
        geo = LocalFrame(home).geo(self.place)
        return _on_earth(geo.latitude_deg, geo.longitude_deg)


class Finder:
    """Finds them event by event, `pairing` the messages with their photos; an empty message tells nothing.

    Nothing is found after the mission was completed. A text is a message and no finding, except `with_texts`.
    """

    def __init__(self, *, with_texts: bool = False) -> None:
        self.found: list[Finding] = []
        self._with_texts = with_texts
        self.pairing = Pairing()
        self._is_over = False
        self._messages = 0
        self._sight: tuple[TakenPhoto | None, Sight | Unplaced] = None, Unplaced(_NO_LENS)

    def take(self, event: Event) -> Sequence[Finding]:
        """What the next event tells of."""
        self.pairing.take(event)
        self._is_over |= isinstance(event, schema.MissionCompleted)
        if not isinstance(event, schema.Notified):
            return ()
        number = self._messages
        self._messages += 1
        if not event.message or self._is_over:
            return ()
        if isinstance(event.message, str) and not self._with_texts:
            return ()
        photo = self.pairing.told_of
        boxes = found_objects(event.message)
        told = []
        for index, box in enumerate([None] if boxes is None else boxes):
            what = box.label if box else in_one_line(event.message)
            place = Unplaced("") if box is None else self._place_of(box, photo)
            told.append(
                Finding(
                    at_s=event.t,
                    what=intern(printable(what, _LONGEST_WORDS)),  # a long flight finds the same many times
                    score=box.score if box else None,
                    waypoint=photo.waypoint if photo else self.pairing.here,
                    named=event.at,
                    box=box,
                    photo=photo,
                    own=place if isinstance(place, Place) else None,
                    unplaced=place.why if isinstance(place, Unplaced) else "",
                    message=number,
                    index=index,
                )
            )
        self.found += told
        return told

    def _place_of(self, box: Outline, photo: TakenPhoto | None) -> Place | Unplaced:
        """Where the object lies by the photo's geometry, or why that is unknown."""
        if photo is None or photo.geometry is None:
            return Unplaced(_NO_LENS)
        if self._sight[0] is not photo:
            self._sight = photo, photo.geometry.sight
        sight = self._sight[1]
        if isinstance(sight, Unplaced):
            return sight
        return sight.place_of(*box.middle_and_size)
