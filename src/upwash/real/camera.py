"""A camera whose photos are the files of a folder."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path

from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo

_SUFFIXES = frozenset({".jpg", ".jpeg"})


class FolderCamera:
    """A Camera that shoots the JPEG files of a folder in name order, over and over; each takes `photo_s`.

    The folder is listed once: files that come later are not seen. Raises UsageError for a folder that is
    missing or has no JPEG file.
    """

    def __init__(self, folder: Path, *, photo_s: float) -> None:
        self._photo_s = photo_s
        self._paths = itertools.cycle(_photos(folder))

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next file after `photo_s` seconds; raises CameraError if it cannot be read."""
        await asyncio.sleep(self._photo_s)
        path = next(self._paths)
        try:
            jpeg = await asyncio.to_thread(path.read_bytes)
        except OSError as error:
            raise CameraError(
                str(path.parent),
                f"{path.name} cannot be read: {error.strerror}; put it back, or start again without it",
            ) from error
        return Photo(jpeg, asyncio.get_running_loop().time(), source=path.name)


def read_photos(folder: Path) -> list[bytes]:
    """Every JPEG file of the folder, in name order; raises UsageError where there is none."""
    return [path.read_bytes() for path in _photos(folder)]


def _photos(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise UsageError(f"camera: there is no folder {folder}; name a folder that holds JPEG photos")
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())
    if not photos:
        raise UsageError(
            f"camera: the folder {folder} has no *.jpg or *.jpeg file; put JPEG photos in it or name another"
        )
    return photos
