"""A camera whose photos are the files of a folder."""

from __future__ import annotations

import asyncio
import errno
import itertools
import os
import stat
from functools import partial
from pathlib import Path

from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo
from upwash.services.photo import NotAPhoto, jpeg_of
from upwash.support.background import in_thread
from upwash.support.loading import extra
from upwash.support.text import by_name

_MOST_BYTES = 100_000_000  # of a photo; a JPEG of 40 megapixels has some 20 MB
_READ_S = 20.0  # a PNG of 40 megapixels takes seconds
_PNG = ".png"
_SUFFIXES = frozenset({".jpg", ".jpeg", _PNG})
_OTHER_SUFFIXES = frozenset({".tif", ".tiff", ".dng", ".heic", ".webp", ".bmp", ".gif", ".jp2", ".avif"})


class FolderCamera:
    """A Camera whose photos are the files of a folder, in name order, again and again; each takes `photo_s`.

    The shutter opens when the photo is there, or `in_flight` at once. A PNG becomes a JPEG. The folder is listed
    once, at the start. Raises UsageError for a folder that is missing or has no photo, and for a PNG without OpenCV.
    """

    def __init__(
        self, folder: Path, *, photo_s: float, lens: Lens | None = None, in_flight: bool = False
    ) -> None:
        self._photo_s = photo_s
        self._in_flight = in_flight
        self._lens = lens
        self._paths = itertools.cycle(photo_files(folder))

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next file after `photo_s` seconds; raises CameraError if it cannot be read, or not in 20 s."""
        clock = asyncio.get_running_loop().time
        asked_s = clock()
        await asyncio.sleep(self._photo_s)
        path = next(self._paths)
        try:
            reading = in_thread(partial(read_photo_file, path), name=f"reading {shown_name(path)}")
            jpeg = await asyncio.wait_for(reading, _READ_S)
        except TimeoutError:
            raise CameraError(
                str(path.parent),
                f"{shown_name(path)} was not read within {_READ_S:g} s; see that its drive is connected",
            ) from None
        captured_s = asked_s if self._in_flight else clock()
        return Photo(jpeg, captured_s, source=shown_name(path), lens=self._lens)


def read_photos(folder: Path, most: int) -> dict[str, bytes]:
    """The first `most` photos of the folder as JPEGs, by file name.

    Raises UsageError if there is none, and CameraError for a file that cannot be read.
    """
    return {shown_name(path): read_photo_file(path) for path in photo_files(folder)[:most]}


def read_photo_file(path: Path) -> bytes:
    """The photo of a file as a JPEG; raises CameraError if it cannot be read or is too large."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is no file any more")
        if (size := status.st_size) > _MOST_BYTES:
            raise OSError(
                errno.EFBIG, f"it has {size / 1e6:.0f} MB, and no photo more than {_MOST_BYTES / 1e6:g}"
            )
        photo = path.read_bytes()
        return jpeg_of(photo) if path.suffix.lower() == _PNG else photo
    except (OSError, NotAPhoto) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise CameraError(
            str(path.parent),
            f"{shown_name(path)} cannot be read: {why}; put it back, or start again without it",
        ) from error


def photo_files(folder: Path) -> list[Path]:
    """The JPEG and PNG files of the folder, photo2 before photo10, without hidden ones.

    macOS leaves a hidden file beside each photo ("._DJI_0001.JPG"). Raises UsageError if there is none, and for a PNG
    without OpenCV.
    """
    try:
        with os.scandir(folder) as entries:
            files = [entry.name for entry in entries if _is_shown_file(entry)]
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(
            f"camera: there is no folder {folder}; name a folder that holds JPEG or PNG photos"
        ) from None
    except OSError as error:  # of another user, or on a drive that is gone
        raise UsageError(
            f"camera: the folder {folder} cannot be read: {error.strerror}; let this user read it, or name another"
        ) from error
    names = sorted((name for name in files if Path(name).suffix.lower() in _SUFFIXES), key=by_name)
    if not names:
        others = sorted({Path(name).suffix for name in files if Path(name).suffix.lower() in _OTHER_SUFFIXES})
        remedy = (
            f"save its {', '.join(others)} files as PNG or JPEG"
            if others
            else "put photos in it or name another"
        )
        raise UsageError(f"camera: the folder {folder} has no *.jpg, *.jpeg or *.png file; {remedy}")
    if any(name.lower().endswith(_PNG) for name in names):
        with extra("detector"):
            import cv2  # noqa: F401
    return [folder / name for name in names]


def _is_shown_file(entry: os.DirEntry[str]) -> bool:
    if entry.name.startswith("."):
        return False
    try:
        return entry.is_file()
    except OSError:  # links in a circle
        return False


def shown_name(path: Path) -> str:
    """The file's name; a name in another encoding can be in no log."""
    return os.fsencode(path.name).decode(errors="replace")
