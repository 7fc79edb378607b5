"""What the user of a drone was told, and the photo that it is about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.eventlog.narration import in_one_line
from upwash.eventlog.schema import Event
from upwash.report.photos import Shot
from upwash.support.text import printable

MOST_PICTURED = 60  # findings; of later ones no boxes are kept, however long the log is
_LONGEST_WORDS = 300  # characters


class Outline(msgspec.Struct, frozen=True, omit_defaults=True):
    """A box in a photo, in its pixels; without a score where it is the photo's truth."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    label: str
    score: float | None = None

    @property
    def words(self) -> str:
        """What it is around, and how sure that is."""
        return self.label if self.score is None else f"{self.label} {100 * self.score:.0f} %"


def outlines(message: object) -> list[Outline] | None:
    """The boxes of a message, None where it is no list of boxes."""
    try:
        return msgspec.convert(message, list[Outline])
    except msgspec.ValidationError:
        return None


@dataclass(frozen=True, slots=True)
class TakenPhoto:
    """The `number`th photo of a run, counted from 0, and the waypoint where it was taken, None before the first."""

    number: int
    shot: Shot
    waypoint: int | None


class Pairing:
    """Follows the events of a run: `told_of` is the photo that the user is told of by a message that comes now.

    That is the last photo, or the one that the call was made with whose answer was taken since.
    """

    def __init__(self) -> None:
        self.last: TakenPhoto | None = None
        self.told_of: TakenPhoto | None = None
        self._here: int | None = None
        self._of_call: dict[int | None, TakenPhoto] = {}  # by the waypoint of calls that are not taken yet
        self._untaken = 0
        self._since_start = 0

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.Arrived(waypoint=waypoint):
                self._here = waypoint
            case schema.PhotoTaken(source=source, position=position):
                number = 0 if self.last is None else self.last.number + 1
                self.last = TakenPhoto(number, Shot(source, position, self._since_start), self._here)
                self.told_of = self.last
                self._since_start += 1
            case schema.CallStarted(waypoint=waypoint):
                self._untaken += 1
                if self.last is not None:
                    self._of_call[waypoint] = self.last
            case schema.AnswerTaken(waypoint=waypoint):
                self.told_of = self._of_call.get(waypoint, self.told_of)
                self._untaken = max(0, self._untaken - 1)
                if not self._untaken:
                    self._of_call.clear()
            case schema.MissionStarted():
                self._here = None
            case schema.LogResumed():
                self._since_start = self._untaken = 0
                self._of_call.clear()


@dataclass(frozen=True, slots=True)
class Finding:
    """What the user was told at a second of the mission, and of which place; `boxes` are on the photo of the shot.

    Those are of the first MOST_PICTURED findings alone.
    """

    at_s: float
    words: str
    waypoint: int | None
    place: Position
    boxes: Sequence[Outline]
    shot: Shot | None


class Findings:
    """Gathers them event by event; an empty message tells nothing."""

    def __init__(self, began_s: float) -> None:
        self.found: list[Finding] = []
        self._began_s = began_s
        self._pairing = Pairing()

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        self._pairing.take(event)
        if isinstance(event, schema.Notified) and event.message:
            photo, boxes = self._pairing.told_of, outlines(event.message) or ()
            words = ", ".join(box.words for box in boxes) or in_one_line(event.message)
            self.found.append(
                Finding(
                    at_s=event.t - self._began_s,
                    words=printable(words, _LONGEST_WORDS),
                    waypoint=photo.waypoint if photo else None,
                    place=event.at,
                    boxes=boxes if len(self.found) < MOST_PICTURED else (),
                    shot=photo.shot if photo else None,
                )
            )
