"""What the detector found in the demonstration's photos, held against what they truly show."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from upwash.core.geo import Position, ground_distance_m
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.narration import counted
from upwash.services import Detection
from upwash.services.solar_park import TrueBox


@dataclass(frozen=True, slots=True)
class Score:
    """Faults in the photos of a flight: how many there truly are, were found, and were imagined."""

    photos: int
    true: int
    found: int
    false: int

    def __add__(self, other: Score) -> Score:
        return Score(
            photos=self.photos + other.photos,
            true=self.true + other.true,
            found=self.found + other.found,
            false=self.false + other.false,
        )

    def in_words(self) -> str:
        """What was found, and what was taken for a fault."""
        return (
            f"faulty modules: {self.found} of {self.true} found, "
            f"{counted(self.false, 'false alarm')}, in {self.photos} photos"
        )


NOTHING = Score(photos=0, true=0, found=0, false=0)


@dataclass(slots=True)
class _Photo:
    """A photo: where it was taken, what it truly shows, and what the user was told of it."""

    position: Position
    truth: list[TrueBox]
    told: list[Detection] = field(default_factory=list)


def score_photos(log: Path) -> Score:
    """What the flight of that event log told its user, held against what its photos truly show."""
    photos: list[_Photo] = []
    for event in event_log.read(log):
        match event:
            case schema.PhotoTaken(truth=truth, position=position) if truth is not None:
                photos.append(_Photo(position, msgspec.convert(truth, list[TrueBox])))
            case schema.Notified(message=message, at=at):  # perhaps after a photo of the next waypoint
                its_own = min(photos, key=lambda photo: ground_distance_m(photo.position, at))
                its_own.told = msgspec.convert(message, list[Detection])
    found = false = 0
    for photo in photos:
        found += sum(any(_is_hit(fault, each) for each in photo.told) for fault in photo.truth)
        false += sum(not any(_is_hit(fault, each) for fault in photo.truth) for each in photo.told)
    return Score(photos=len(photos), true=sum(len(photo.truth) for photo in photos), found=found, false=false)


def _is_hit(fault: TrueBox, detection: Detection) -> bool:
    """Whether the detection names the fault and has its middle on it."""
    x = detection.left_px + detection.width_px / 2 - fault.left_px
    y = detection.top_px + detection.height_px / 2 - fault.top_px
    return detection.label == fault.label and 0 <= x <= fault.width_px and 0 <= y <= fault.height_px
