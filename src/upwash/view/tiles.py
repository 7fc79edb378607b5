"""Map tiles that lie beneath a page's map: from elsewhere by a URL, or from a file or folder of this machine.

Tiles are pictures in Web Mercator, counted from the north-west. MBTiles count their rows from the south.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import sqlite3
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import msgspec

from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.report.markup import in_document
from upwash.support.loading import extra

_URL = re.compile(r"(https?://[A-Za-z0-9.-]+(?::\d+)?)/[^\s\"'<>]*")
_SERVED = "tiles/{z}/{x}/{y}"  # by the page's own program
_MOST_ZOOM = 30
_MOST_BYTES = 2**20  # of a tile, and of a directory of tiles, inflated too
_MOST_STEPS = 50_000_000  # of SQLite for one question, as a view may have no end: a second or two
# The kinds of pictures by their first bytes.
_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
_GZIP = b"\x1f\x8b"
_SUFFIXES = ("png", "jpg", "jpeg", "webp")
_AT_ONCE, _OVERVIEW = 16, 15  # of the first zoom that a document has: the most tiles, and the zoom
_MOST_INLINED = 2_000
INLINED_BYTES = 8_000_000  # of the tiles in a document

Find: TypeAlias = Callable[[int, int, int], bytes | None]  # the tile at zoom, x and y


class Tiles(msgspec.Struct, frozen=True):
    """The tiles of a page: their URL with {z}, {x} and {y}, their zooms, and their maker's `credit`.

    Without a URL the tiles are in the document.
    """

    url: str
    credit: str = ""
    from_zoom: int = 0
    to_zoom: int = 19

    @property
    def sources(self) -> tuple[str, ...]:
        """From where browsers must be allowed to load images; Leaflet blanks those it lets go of by a `data:` URL."""
        found = _URL.fullmatch(self.url)
        return (found[1], "data:") if found else ()


class BaseMap(NamedTuple):
    """Tiles, and how to find each; None where they are another machine's."""

    tiles: Tiles
    find: Find | None = None


def base_map(source: Path | str, credit: str = "") -> BaseMap:
    """The map at a URL, or of a path: a folder ZOOM/X/Y.png, or a file .mbtiles or .pmtiles; raises UsageError."""
    if isinstance(source, str):
        if _URL.fullmatch(source) is None or not all(part in source for part in ("{z}", "{x}", "{y}")):
            raise UsageError(
                f"{source!r} is no address of map tiles: write it as https://HOST/{{z}}/{{x}}/{{y}}.png"
            )
        return BaseMap(Tiles(source, credit))
    openers = {".mbtiles": _mbtiles, ".pmtiles": _pmtiles}
    opener = _folder if source.is_dir() else openers.get(source.suffix.lower())
    if opener is None:
        raise UsageError(
            f"{source} is no map: give a folder with tiles as ZOOM/X/Y.png, a file .mbtiles or .pmtiles, or "
            "https://HOST/{z}/{x}/{y}.png"
        )
    if not source.is_dir() and not source.is_file():
        raise UsageError(f"there is no file {source}")
    try:
        find, from_zoom, to_zoom, own_credit = opener(source)
    except OSError as error:
        raise UsageError(f"{source} cannot be read: {error.strerror or error}") from error
    if not 0 <= from_zoom <= to_zoom <= _MOST_ZOOM:
        raise UsageError(f"{source} has no zooms from 0 to {_MOST_ZOOM}: it says {from_zoom} to {to_zoom}")
    return BaseMap(Tiles(_SERVED, credit or own_credit, from_zoom, to_zoom), find)


def kind_of(tile: bytes) -> str | None:
    """The media type of a tile's picture; None where it is none."""
    return next((kind for begins, kind in _KINDS.items() if tile.startswith(begins)), None)


_Opened: TypeAlias = tuple[Find, int, int, str]  # with the lowest and the highest zoom, and the credit


def _folder(folder: Path) -> _Opened:
    zooms = sorted(int(each.name) for each in folder.iterdir() if each.name.isdecimal() and each.is_dir())
    if not zooms:
        raise UsageError(f"{folder} has no map tiles: they must lie there as ZOOM/X/Y.png")

    def find(z: int, x: int, y: int) -> bytes | None:
        for suffix in _SUFFIXES:
            with (
                contextlib.suppress(OSError),
                (folder / str(z) / str(x) / f"{y}.{suffix}").open("rb") as file,
            ):
                tile = file.read(_MOST_BYTES + 1)
                return tile if len(tile) <= _MOST_BYTES else None
        return None

    return find, zooms[0], zooms[-1], ""


def _mbtiles(file: Path) -> _Opened:
    lock = threading.Lock()
    try:
        database = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)
        database.set_progress_handler(lambda: True, _MOST_STEPS)
        named = "SELECT name, value FROM metadata WHERE name IN ('format', 'attribution') LIMIT 2"
        said = {str(name): str(value) for name, value in database.execute(named)}
        # Apart, as SQLite takes one end from an index, and both from all tiles.
        ends = "SELECT (SELECT min(zoom_level) FROM tiles), (SELECT max(zoom_level) FROM tiles)"
        low, high = database.execute(ends).fetchone()
    except sqlite3.Error as error:
        why = "its tables do not end" if str(error) == "interrupted" else error
        raise UsageError(f"{file} is no MBTiles file: {why}") from error
    if said.get("format", "png") == "pbf":
        raise UsageError(_vector(file))
    if low is None or not isinstance(low, int) or not isinstance(high, int):
        raise UsageError(f"{file} has no tiles")

    def find(z: int, x: int, y: int) -> bytes | None:
        with lock, contextlib.suppress(sqlite3.Error):
            row = database.execute(
                "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ? "
                "AND length(tile_data) <= ?",
                (z, x, 2**z - 1 - y, _MOST_BYTES),
            ).fetchone()
            return row[0] if row and isinstance(row[0], bytes) else None
        return None

    return find, low, high, said.get("attribution", "")


def _pmtiles(file: Path) -> _Opened:
    with extra("view"):
        from pmtiles.reader import MmapSource, Reader
        from pmtiles.tile import TileType
    with file.open("rb") as opened:
        content = MmapSource(opened)

    def read(offset: int, length: int) -> bytes:
        if length > _MOST_BYTES:
            raise ValueError(f"a part of {length} bytes is more than the {_MOST_BYTES} that are read")
        part = bytes(content(offset, length))
        if part.startswith(_GZIP):
            inflating = zlib.decompressobj(zlib.MAX_WBITS | 16)
            inflating.decompress(part, _MOST_BYTES)
            if not inflating.eof or inflating.unused_data:
                raise ValueError(f"a part has more than {_MOST_BYTES} bytes, or its end is damaged")
        return part

    reader = Reader(read)
    try:
        header: dict[str, Any] = reader.header()
        credit = str(reader.metadata().get("attribution", ""))
    except Exception as error:
        raise UsageError(f"{file} is no PMTiles file that can be read: {error}") from error
    if header["tile_type"] not in (TileType.PNG, TileType.JPEG, TileType.WEBP):
        raise UsageError(_vector(file))

    def find(z: int, x: int, y: int) -> bytes | None:
        with contextlib.suppress(Exception):  # of a damaged file: the place stays empty
            tile = reader.get(z, x, y)
            return None if tile is None else bytes(tile)
        return None

    return find, header["min_zoom"], header["max_zoom"], credit


def _vector(file: Path) -> str:
    return f"{file} has no pictures: the page shows tiles in PNG, JPEG or WebP, and no vector tiles"


def inlined(
    found: BaseMap, places: Iterable[GeoPosition], *, most_bytes: int = INLINED_BYTES
) -> tuple[Tiles, dict[str, str]]:
    """The tiles around these places as `data:` URLs by "z/x/y": from an overview to the finest zoom that has room."""
    if found.find is None:
        raise UsageError(
            "a document refers to no other machine: give --tiles a folder, an .mbtiles or a .pmtiles"
        )
    corners, kept, size = list(places), dict[str, str](), 0
    zooms = range(found.tiles.from_zoom, found.tiles.to_zoom + 1)
    broad = [zoom for zoom in zooms if zoom <= _OVERVIEW and len(_around(corners, zoom)) <= _AT_ONCE]
    first = max(broad, default=zooms[0])
    to_zoom = first
    for zoom in range(first, zooms[-1] + 1):
        wanted = _around(corners, zoom)
        if len(kept) + len(wanted) > _MOST_INLINED:
            break
        urls = dict(_urls(found.find, zoom, wanted))
        size += sum(map(len, urls.values()))
        if size > most_bytes:
            break
        kept |= urls
        to_zoom = zoom
    if not kept:
        raise UsageError(
            "the map has no tile around the flights. It is of another place, or the logs have no mission.home, or "
            "the folder counts its rows from the south. gdal2tiles counts rows from the north with --xyz"
        )
    return Tiles("", found.tiles.credit, first, to_zoom), kept


def _urls(find: Find, zoom: int, wanted: Iterable[tuple[int, int]]) -> Iterator[tuple[str, str]]:
    for x, y in wanted:
        if (tile := find(zoom, x, y)) is not None and (kind := kind_of(tile)) is not None:
            yield f"{zoom}/{x}/{y}", in_document(tile, kind)


def _around(corners: Iterable[GeoPosition], zoom: int) -> list[tuple[int, int]]:
    """The tiles of the rectangle around the places, and one more on each side."""
    tiles = [_tile_of(corner, zoom) for corner in corners]
    if not tiles:
        return []
    xs, ys = [x for x, _ in tiles], [y for _, y in tiles]
    last = 2**zoom - 1
    wide = range(max(0, min(xs) - 1), min(last, max(xs) + 1) + 1)
    high = range(max(0, min(ys) - 1), min(last, max(ys) + 1) + 1)
    return list(itertools.islice(itertools.product(wide, high), _MOST_INLINED + 1))


def _tile_of(place: GeoPosition, zoom: int) -> tuple[int, int]:
    count, latitude = 2**zoom, math.radians(max(-85.05, min(85.05, place.latitude_deg)))
    x = (place.longitude_deg + 180) / 360 * count
    y = (1 - math.asinh(math.tan(latitude)) / math.pi) / 2 * count
    return min(count - 1, max(0, int(x))), min(count - 1, max(0, int(y)))
