"""A camera whose photos are the files of a folder."""

from __future__ import annotations

import asyncio
import errno
import itertools
import os
from pathlib import Path

from upwash.core.geo import Position
from upwash.core.lens import Lens
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo

_MOST_BYTES = 100_000_000  # of a photo; a JPEG of 40 megapixels has some 20 MB
_SUFFIXES = frozenset({".jpg", ".jpeg"})


class FolderCamera:
    """A Camera whose photos are the JPEG files of a folder, in name order, again and again; each takes `photo_s`.

    The folder is listed once, at the start. Raises UsageError for a folder that is missing or has no JPEG file.
    """

    def __init__(self, folder: Path, *, photo_s: float, lens: Lens | None = None) -> None:
        self._photo_s = photo_s
        self._lens = lens
        self._paths = itertools.cycle(photo_files(folder))

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next file after `photo_s` seconds; raises CameraError if it cannot be read."""
        await asyncio.sleep(self._photo_s)
        path = next(self._paths)
        jpeg = await asyncio.to_thread(read_photo_file, path)
        return Photo(jpeg, asyncio.get_running_loop().time(), source=path.name, lens=self._lens)


def read_photos(folder: Path, most: int) -> dict[str, bytes]:
    """The contents of the first `most` JPEG files of the folder, by file name.

    Raises UsageError if there is none, and CameraError for a file that cannot be read.
    """
    return {path.name: read_photo_file(path) for path in photo_files(folder)[:most]}


def read_photo_file(path: Path) -> bytes:
    """The contents of a photo file; raises CameraError if it cannot be read or is too large."""
    try:
        if (size := path.stat().st_size) > _MOST_BYTES:
            raise OSError(
                errno.EFBIG, f"it has {size / 1e6:.0f} MB, and no photo more than {_MOST_BYTES / 1e6:g}"
            )
        return path.read_bytes()
    except OSError as error:
        raise CameraError(
            str(path.parent),
            f"{path.name} cannot be read: {error.strerror}; put it back, or start again without it",
        ) from error


def photo_files(folder: Path) -> list[Path]:
    """The JPEG files of the folder in name order, without hidden ones; raises UsageError if there is none.

    macOS leaves a hidden file beside each photo ("._DJI_0001.JPG").
    """
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if _is_photo(entry))
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(
            f"camera: there is no folder {folder}; name a folder that holds JPEG photos"
        ) from None
    except OSError as error:  # of another user, or on a drive that is gone
        raise UsageError(
            f"camera: the folder {folder} cannot be read: {error.strerror}; let this user read it, or name another"
        ) from error
    if not names:
        raise UsageError(
            f"camera: the folder {folder} has no *.jpg or *.jpeg file; put JPEG photos in it or name another"
        )
    return [folder / name for name in names]


def _is_photo(entry: os.DirEntry[str]) -> bool:
    return not entry.name.startswith(".") and Path(entry.name).suffix.lower() in _SUFFIXES and entry.is_file()
