"""Accepted findings as a data set that YOLO's tools train with: photos, boxes, and the names of the classes."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from upwash.errors import NotWritten, UsageError
from upwash.eventlog.objects import Outline
from upwash.report.crops import size_of
from upwash.report.photos import PhotoShelf, Shot
from upwash.report.record import Record, reviewed_of
from upwash.report.reviewed import ReviewedFindings
from upwash.support.text import counted

_ODD = re.compile(r"[^\w.-]+")
_DIGITS = 6


@dataclass(slots=True)
class _Labelled:
    """A photo with accepted boxes; `others` counts the boxes on it without a verdict."""

    shot: Shot
    accepted: list[Outline] = field(default_factory=list)
    others: int = 0


def require_new(folder: Path) -> None:
    """Raises UsageError if the folder, or a file of its name, exists."""
    if folder.exists() or folder.is_symlink():
        raise UsageError(f"{folder} exists: a data set is a new folder, so give another name")


def write_dataset(records: Sequence[Record], folder: Path, *, photos: Path | None = None) -> str:
    """Writes a new folder with the photos that have accepted boxes, and returns what it has, in a sentence.

    All sightings of an accepted object are accepted. Raises UsageError if the folder exists or would have no photo,
    and NotWritten; the folder is whole or not there.
    """
    require_new(folder)
    named = _labelled(reviewed_of(records))
    if not named:
        raise UsageError(
            "no box is accepted, so a data set would be empty: accept findings on the flight page first"
        )
    classes = sorted({box.label for photo in named.values() for box in photo.accepted})
    try:
        unfinished = folder.with_name(f".upwash-{secrets.token_hex(4)}")
        unfinished.mkdir(parents=True)
        try:
            written = _write_photos(unfinished, named, classes, PhotoShelf(photos))
            (unfinished / "data.yaml").write_text(_data(classes), encoding="utf-8")
            if written:
                unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise NotWritten(folder, error, "nothing of the data set was left there") from error
    if not written:
        raise UsageError(
            "none of the photos with accepted boxes can be had: give --photos, the folder of [camera], and install "
            "upwash[detector]"
        )
    return _told(named, written, classes)


def _labelled(reviewed: ReviewedFindings) -> dict[str, _Labelled]:
    photos: dict[tuple[int, str], _Labelled] = {}
    for number, flight in enumerate(reviewed.flights):
        for index, finding in enumerate(flight.found):
            found = reviewed.of_finding(number, index)
            shown = found.sighting(finding)
            if shown.photo is None or shown.box is None or found.is_rejected:
                continue
            name = _name_of(shown.photo.shot, shown.photo.number)
            photo = photos.setdefault((number, name), _Labelled(shown.photo.shot))
            if found.is_accepted:
                photo.accepted.append(shown.box)
            else:
                photo.others += 1
    named: dict[str, _Labelled] = {}
    for (number, name), photo in photos.items():
        if photo.accepted:
            plain = _ODD.sub("_", f"{number + 1}-{name}" if len(reviewed.flights) > 1 else name)
            named[plain if plain not in named else f"{plain}-{len(named) + 1}"] = photo
    return named


def _name_of(shot: Shot, number: int) -> str:
    """The name of the photo's file without .jpg; a rendered photo has its number in the flight."""
    return shot.source.removesuffix(".jpg") if "." in shot.source else f"{shot.source}-{number + 1:05}"


def _write_photos(
    folder: Path, named: dict[str, _Labelled], classes: Sequence[str], shelf: PhotoShelf
) -> Counter[str]:
    """Writes the photos that can be had, each with its boxes; returns the number of boxes by label."""
    written = Counter[str]()
    for part in ("images", "labels"):
        (folder / part).mkdir()
    for name, photo in named.items():
        jpeg = shelf.find(photo.shot)
        size = None if jpeg is None else size_of(jpeg)
        if jpeg is None or size is None:
            continue
        lines = []
        for box in photo.accepted:
            if (place := _normalised(box, *size)) is not None:
                lines.append(f"{classes.index(box.label)} {place}\n")
                written[box.label] += 1
        if lines:
            (folder / "images" / f"{name}.jpg").write_bytes(jpeg)
            (folder / "labels" / f"{name}.txt").write_text("".join(lines), encoding="ascii")
    return written


def _normalised(box: Outline, width_px: int, height_px: int) -> str | None:
    """The middle and the size of the part of the box within the photo, as shares; None if there is none."""
    left, top = max(0.0, box.left_px), max(0.0, box.top_px)
    right = min(float(width_px), box.left_px + box.width_px)
    bottom = min(float(height_px), box.top_px + box.height_px)
    if right <= left or bottom <= top:
        return None
    middle = (left + right) / 2 / width_px, (top + bottom) / 2 / height_px
    shares = *middle, (right - left) / width_px, (bottom - top) / height_px
    return " ".join(f"{share:.{_DIGITS}f}" for share in shares)


def _data(classes: Sequence[str]) -> str:
    """The description that YOLO's tools read; a JSON string is one of YAML too."""
    names = "".join(
        f"  {number}: {json.dumps(name, ensure_ascii=False)}\n" for number, name in enumerate(classes)
    )
    return f"train: images\nval: images\nnames:\n{names}"


def _told(named: dict[str, _Labelled], written: Counter[str], classes: Sequence[str]) -> str:
    accepted = sum(len(photo.accepted) for photo in named.values())
    parts = [f"{counted(written.total(), 'box')} of {counted(len(classes), 'class')}"]
    if lacking := accepted - written.total():
        parts.append(
            f"{counted(lacking, 'accepted box')} left out, as the photo is lacking or the box is empty"
        )
    if others := sum(photo.others for photo in named.values()):
        parts.append(
            f"{counted(others, 'box')} on these photos not reviewed, which a network takes for background"
        )
    return "; ".join(parts)
