"""The photos of a flight as files that mapping programs read."""

from __future__ import annotations

import asyncio
import itertools
import os
import re
from pathlib import Path

from upwash.core.geo import EarthPosition
from upwash.errors import NotWritten, UsageError
from upwash.ports import KeptPhoto
from upwash.support.exif import with_pose
from upwash.support.output_files import append_whole, write_file

_HEADER = "EPSG:4326\n"
_GEO = "geo.txt"
_LONGEST_NAME = 80  # characters


def require_room_for(folder: Path) -> None:
    """Raise UsageError where the folder is none, and cannot be made."""
    folder = Path(os.path.abspath(folder))  # noqa: PTH100 - links stay, as `..` in the path is the user's
    there = next(each for each in (folder, *folder.parents) if os.path.lexists(each))
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        why = "is no folder" if not there.is_dir() else "is not for this user to write to"
        raise UsageError(f"camera.keep: {folder} cannot be made, as {there} {why}: name another folder")


class FolderAlbum:
    """An Album in a folder: a JPEG a photo, and their places and angles in `geo.txt`, as OpenDroneMap reads it.

    Each flight has a folder of its own: `folder`, or where an earlier flight has photos there `folder`-2 and so on; a
    flight that `resumes` has the last of these. Raises UsageError if the folder cannot be made.
    """

    def __init__(self, folder: Path, *, resumes: bool = False) -> None:
        try:
            folder = _of_flight(folder, resumes=resumes)
            folder.mkdir(parents=True, exist_ok=True)
            self._count = _photos_in(folder)
        except OSError as error:
            raise UsageError(
                f"camera.keep: {folder} cannot be made: {error.strerror}; name another folder"
            ) from error
        self._folder = folder
        self._lock = asyncio.Lock()

    async def keep(self, photo: KeptPhoto) -> str:
        """Writes the photo, with its angles as XMP, and its line; raises NotWritten."""
        async with self._lock:
            return await asyncio.to_thread(self._keep, photo)

    def _keep(self, photo: KeptPhoto) -> str:
        jpeg = photo.jpeg
        if photo.angles_deg is not None and photo.errors_m is not None:
            jpeg = with_pose(jpeg, photo.angles_deg, photo.errors_m)
        name = self._name(photo.source)
        write_file(self._folder / name, jpeg)
        self._count += 1
        if photo.earth is not None:
            self._append(_line(name, photo.earth, photo))
        return name

    def _name(self, source: str) -> str:
        """The photo's number, and the name of its file if it came from one."""
        stem = "".join(letter if letter.isalnum() else "_" for letter in Path(source).stem)[:_LONGEST_NAME]
        own = f"-{stem}" if Path(source).suffix.lower() in {".jpg", ".jpeg", ".png"} else ""
        return f"{self._count + 1:05}{own}.jpg"

    def _append(self, line: str) -> None:
        file = self._folder / _GEO
        try:
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                size_bytes = os.fstat(descriptor).st_size
                is_torn = size_bytes > 0 and os.pread(descriptor, 1, size_bytes - 1) != b"\n"
                begins = _HEADER if not size_bytes else "\n" if is_torn else ""
                append_whole(descriptor, (begins + line).encode())
            finally:
                os.close(descriptor)
        except OSError as error:
            raise NotWritten(file, error, "the photo is there without its line") from error


def _of_flight(folder: Path, *, resumes: bool) -> Path:
    others = (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))
    last = folder
    for each in itertools.chain((folder,), others):
        if not _photos_in(each):
            return last if resumes else each
        last = each
    raise AssertionError  # the names have no end


def _photos_in(folder: Path) -> int:
    """The highest number of a photo that was kept there, 0 without one."""
    numbers = (re.match(r"(\d{5,})(?:-.*)?\.jpg$", file.name) for file in folder.glob("*.jpg"))
    return max((int(number[1]) for number in numbers if number), default=0)


def _line(name: str, earth: EarthPosition, photo: KeptPhoto) -> str:
    """The photo's line: longitude, latitude, altitude, yaw, pitch, roll and the two errors, as far as known."""
    numbers = [f"{earth.longitude_deg:.8f}", f"{earth.latitude_deg:.8f}"]
    if earth.above_sea_m is not None:
        numbers.append(f"{earth.above_sea_m:.2f}")
        if photo.angles_deg is not None and photo.errors_m is not None:
            numbers += [f"{value:.2f}" for value in (*photo.angles_deg, *photo.errors_m)]
    return " ".join((name, *numbers)) + "\n"
