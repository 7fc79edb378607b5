"""A camera whose photos are the files of a folder."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path

from upwash.errors import UpwashError, UsageError

_SUFFIXES = frozenset({".jpg", ".jpeg"})


class FolderCamera:
    """A Camera that shoots the JPEG files of a folder in name order, over and over; each takes `photo_s`.

    The folder is listed once: files that come later are not seen. Raises UsageError for a folder that is
    missing or has no JPEG file.
    """

    def __init__(self, folder: Path, *, photo_s: float) -> None:
        self._photo_s = photo_s
        self._paths = itertools.cycle(_photos(folder))

    async def take_photo(self) -> bytes:
        """Returns the next file's bytes after `photo_s` seconds; raises UpwashError if it cannot be read."""
        await asyncio.sleep(self._photo_s)
        path = next(self._paths)
        try:
            return await asyncio.to_thread(path.read_bytes)
        except OSError as error:
            raise UpwashError(
                f"camera: {path} cannot be read: {error.strerror}; put it back, or start again without it"
            ) from error


def _photos(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise UsageError(f"camera: there is no folder {folder}; name a folder that holds JPEG photos")
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())
    if not photos:
        raise UsageError(
            f"camera: the folder {folder} has no *.jpg or *.jpeg file; put JPEG photos in it or name another"
        )
    return photos
