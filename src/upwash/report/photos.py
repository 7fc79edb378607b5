"""Photos that a log tells of: found in a folder, or rendered again."""

from __future__ import annotations

import functools
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path

from upwash.core.geo import Position
from upwash.support.exif import unturned
from upwash.support.png import SIGNATURE

_PARK = re.compile(r"park (\d{1,18})")
_FARTHEST_M = 100_000.0
_LARGEST_BYTES = 2**25
_JPEG = b"\xff\xd8\xff"
_KEPT = 16


@dataclass(frozen=True, slots=True)
class Shot:
    """A photo that the log tells of, the `since_start`th since the program began, counted from 0."""

    source: str
    position: Position | None
    since_start: int


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:
        return False


class PhotoShelf:
    """Finds photos by what the log says of them: in `folder` by name, or in the park, rendered again."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._can_render = _is_installed("cv2") and _is_installed("numpy")
        self.find = functools.lru_cache(_KEPT)(self._find)

    def keeps(self, source: str) -> bool:
        """Whether photos of that source can be had."""
        if _PARK.fullmatch(source):
            return self._can_render
        return self._folder is not None and _is_name(source)

    def _find(self, shot: Shot) -> bytes | None:
        """The JPEG of that shot, None where it is not to be had; takes a while."""
        if park := _PARK.fullmatch(shot.source):
            return self._rendered(int(park[1]), shot) if self._can_render else None
        if self._folder is None or not _is_name(shot.source):
            return None
        photo = _read_photo(self._folder / shot.source)
        if photo.startswith(SIGNATURE):
            return _jpeg_of(photo) if self._can_render else None
        return unturned(photo) if photo.startswith(_JPEG) else None

    def _rendered(self, seed: int, shot: Shot) -> bytes | None:
        from upwash.services.solar_park import Park, View, photograph

        at = shot.position
        if at is None or max(abs(at.east_m), abs(at.north_m)) > _FARTHEST_M:
            return None
        view = View(at.east_m, at.north_m, at.altitude_m)
        return photograph(Park(seed), view, shot=shot.since_start).jpeg


def _is_name(source: str) -> bool:
    """Whether it is the bare name of a file: a log may be anybody's."""
    return Path(source).name == source and source not in {"", ".."} and "\0" not in source


def _read_photo(file: Path) -> bytes:
    """The content of the file, b"" if it cannot be had or is too large."""
    try:
        if not file.is_file():
            return b""
        with file.open("rb") as opened:
            photo = opened.read(_LARGEST_BYTES + 1)
    except OSError:
        return b""
    return photo if len(photo) <= _LARGEST_BYTES else b""


def _jpeg_of(png: bytes) -> bytes | None:
    from upwash.services.photo import NotAPhoto, jpeg_of

    try:
        return jpeg_of(png)
    except NotAPhoto:
        return None
