"""The flight page as a file: with everything that its logs tell, and with photos, so that no program serves it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.eventlog.results import RunResult
from upwash.report.crops import shrunk
from upwash.report.finding_files import as_csv, as_geojson, as_kml
from upwash.report.markup import in_document
from upwash.report.photos import PhotoShelf, Shot
from upwash.report.record import Record, reviewed_of
from upwash.report.sheet import draw_sheet
from upwash.support.text import counted
from upwash.view.document import document
from upwash.view.feed import Feed
from upwash.view.recording import Recording, reading
from upwash.view.tiles import BaseMap, inlined

_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:"
_SIDE_BY_SIDE = 3  # flights, which the title names
_MOST_BYTES = 2**24  # of facts, which a file has some ten times in memory while it is made
_PHOTOS, _PHOTO_PX = 60, 640  # in a file, and how wide they are at most
_FILED = 1000  # findings; of more, the page has no files for other tools


class _Photo(msgspec.Struct, frozen=True):
    source: str
    width: int
    height: int


class _Album(PhotoShelf):
    """Finds photos, and makes those small that the page is known to show while it has them: rendering takes long."""

    def __init__(self, folder: Path | None, shown: Iterable[Shot]) -> None:
        super().__init__(folder)
        self._small: dict[Shot, _Photo | None] = {}
        self._shown = set(shown)

    def _find(self, shot: Shot) -> bytes | None:
        jpeg = super()._find(shot)
        if shot in self._shown:
            self._small[shot] = _small(jpeg)
        return jpeg

    def small(self, shot: Shot) -> _Photo | None:
        """The photo as the page has it."""
        jpeg = None if shot in self._small else self.find(shot)
        return self._small[shot] if shot in self._small else _small(jpeg)


def write_page(
    logs: Sequence[Path],
    records: Sequence[Record],
    *,
    photos: Path | None = None,
    flown: Mapping[str, RunResult] | None = None,
    unreviewed: bool = False,
    beneath: BaseMap | None = None,
) -> Iterator[bytes]:
    """The page about these logs, whose records these are, piece by piece.

    Photos are of that folder where the logs name them, and rendered ones. `flown` is what other policies did in the
    world of the one log, by name. Reviews count, except `unreviewed`, which the records must be too. Of the map
    `beneath` the page has the tiles around the flights. Raises UsageError for what is no event log.
    """
    names = ", ".join(record.name for record in records)
    title = f"Flight report: {names if len(records) <= _SIDE_BY_SIDE else counted(len(records), 'flight')}"
    begin, end = document(title, policy=_POLICY)
    yield begin.encode()
    found = [finding.photo.shot for record in records for finding in record.findings if finding.photo]
    album = _Album(photos, itertools.islice(dict.fromkeys(found), _PHOTOS))
    yield draw_sheet(records, album).encode()
    tiles, kept = inlined(beneath, _places(records)) if beneath else (None, {})
    if kept:
        yield from _data("tiles", [msgspec.json.encode(kept)])
    yield from _data("files", [msgspec.json.encode(_files(records))])  # before the facts need memory
    with reading(logs, album.keeps, most_bytes=_MOST_BYTES // len(logs)) as recordings:
        feed = Feed(recordings, tiles, flown, unreviewed=unreviewed)
        yield from _data("told", _items(feed.everything()))
        shown = itertools.islice(_photos(recordings, album), _PHOTOS)
        yield from _data("photos", _members(shown))
    yield end.encode()


def _places(records: Sequence[Record]) -> Iterator[GeoPosition]:
    """The corners of the fields that the flights planned, and of where they flew."""
    for record in records:
        if record.plan.home is None:
            continue
        flown = ((fix.position.east_m, fix.position.north_m) for fix in record.track)
        east, north = zip((0.0, 0.0), *record.plan.way_m, *flown, strict=True)
        frame = LocalFrame(record.plan.home)
        yield from (frame.geo(Position(min(east), min(north))), frame.geo(Position(max(east), max(north))))


def _files(records: Sequence[Record]) -> dict[str, str]:
    reviewed = reviewed_of(records)
    found, words = reviewed.objects, reviewed.tally.words
    if len(found) > _FILED:
        return {}
    writers = {"csv": as_csv, "geojson": as_geojson, "kml": as_kml}
    return {f"findings.{format_}": write(found, None, words) for format_, write in writers.items()}


def _photos(recordings: Sequence[Recording], album: _Album) -> Iterator[tuple[str, _Photo]]:
    """The available photos by log and number, photos with findings first."""
    for outlined in (True, False):
        for log, recording in enumerate(recordings):
            for number, shot in enumerate(recording.news.shots):
                if (number in recording.news.outlined) is outlined and album.keeps(shot.source):
                    photo = album.small(shot)
                    if photo is not None:
                        yield f"{log}/{number}", photo


def _small(jpeg: bytes | None) -> _Photo | None:
    photo = None if jpeg is None else shrunk(jpeg, _PHOTO_PX)
    if photo is None:
        return None
    content, width, height = photo
    return _Photo(in_document(content), width, height)


def _items(items: Iterable[object]) -> Iterator[bytes]:
    """A JSON array, piece by piece."""
    for number, item in enumerate(items):
        yield (b"," if number else b"[") + msgspec.json.encode(item)
    yield b"]"


def _members(members: Iterable[tuple[str, object]]) -> Iterator[bytes]:
    """A JSON object, piece by piece."""
    yield b"{"
    for number, (name, value) in enumerate(members):
        yield (b"," if number else b"") + msgspec.json.encode(name) + b":" + msgspec.json.encode(value)
    yield b"}"


def _data(name: str, pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Data for the page's scripts, as JSON; nothing in it ends the element."""
    yield f'<script type="application/json" id="{name}">'.encode()
    yield from (piece.replace(b"<", b"\\u003c") for piece in pieces)
    yield b"</script>"
