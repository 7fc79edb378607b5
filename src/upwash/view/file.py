"""The flight page as a file: with everything that its logs tell, and with photos, so that no program serves it."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from upwash.eventlog.narration import counted
from upwash.eventlog.results import RunResult
from upwash.report.crops import shrunk
from upwash.report.finding_files import as_csv, as_geojson, as_kml
from upwash.report.markup import Markup, element
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, findings_of
from upwash.report.sheet import draw_sheet
from upwash.view.document import write_document
from upwash.view.feed import Feed
from upwash.view.recording import Recording, reading

_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:"
_SIDE_BY_SIDE = 3  # flights, which the title names
_MOST_BYTES = 2**24  # of facts, which a file has some ten times in memory while it is made
_PHOTOS, _PHOTO_PX = 60, 640  # in a file, and how wide they are at most
_FILED = 1000  # findings; of more, the page has no files for other tools


class _Photo(msgspec.Struct, frozen=True):
    """A photo of a page: its source, and how large it was in pixels."""

    source: str
    width: int
    height: int


def write_page(
    logs: Sequence[Path],
    records: Sequence[Record],
    *,
    photos: Path | None = None,
    flown: Mapping[str, RunResult] | None = None,
) -> str:
    """The page about these logs, whose records these are.

    Photos are of that folder where the logs name them, and rendered ones. `flown` is what other policies did in the
    world of the one log, by name. Raises UsageError for what is no event log.
    """
    shelf = PhotoShelf(photos)
    with reading(logs, shelf.keeps, most_bytes=_MOST_BYTES // len(logs)) as recordings:
        told = Feed(recordings, flown=flown).everything()
        shown = dict(itertools.islice(_photos(recordings, shelf), _PHOTOS))
    names = ", ".join(record.name for record in records)
    title = f"Flight report: {names if len(records) <= _SIDE_BY_SIDE else counted(len(records), 'flight')}"
    return write_document(
        title,
        draw_sheet(records, shelf),
        _data("told", told),
        _data("photos", shown),
        _data("files", _files(records)),
        policy=_POLICY,
    )


def _files(records: Sequence[Record]) -> dict[str, str]:
    """The files that the page has of what was found, by name."""
    found = findings_of(records)
    if len(found) > _FILED:
        return {}
    files = {"csv": as_csv(found), "geojson": as_geojson(found), "kml": as_kml(found)}
    return {f"findings.{format_}": text for format_, text in files.items()}


def _photos(recordings: Sequence[Recording], shelf: PhotoShelf) -> Iterator[tuple[str, _Photo]]:
    """The available photos by log and number, photos with findings first."""
    for outlined in (True, False):
        for log, recording in enumerate(recordings):
            for number, shot in enumerate(recording.story.shots):
                if (number in recording.story.outlined) is outlined and shelf.keeps(shot.source):
                    jpeg = shelf.find(shot)
                    if jpeg is not None and (photo := shrunk(jpeg, _PHOTO_PX)) is not None:
                        content, width, height = photo
                        source = f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
                        yield f"{log}/{number}", _Photo(source, width, height)


def _data(name: str, data: object) -> Markup:
    """Data for the page's scripts; nothing in it ends the element."""
    written = msgspec.json.encode(data).replace(b"<", b"\\u003c").decode()
    return element("script", Markup(written), type="application/json", id=name)
