"""Looks, before a flight, at what the configured camera gives."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from upwash.config import DroneConfig
from upwash.core.geo import Position
from upwash.errors import CameraError
from upwash.launch.cameras import needs_camera, opened_camera
from upwash.real.camera.camera import photo_files, read_photo_file
from upwash.support.jpeg import EOI, segments_of

_MOST_FILES = 2000  # of a folder: a card may hold more than a person waits for
_MOST_S = 60.0
_MOST_NAMED = 5
_APART_S = 1.0  # between two photos that cannot be the same
_DARKEST = 16  # of 255: what a sensor shows behind its cap


@dataclass(frozen=True, slots=True)
class Look:
    """Photos by their names, for calls of services, and what is wrong with the camera or with its photos."""

    photos: Mapping[str, bytes]
    troubles: tuple[str, ...] = ()


async def look(config: DroneConfig) -> Look:
    """What the camera gives: of a folder its first photo and its largest one; none where the mission takes none.

    Raises UsageError for a camera that cannot be, and CameraError for one that gives no photo.
    """
    if not needs_camera(config):
        return Look({})
    if config.camera.folder is not None:
        return await asyncio.to_thread(_look_at_files, config.camera.folder)
    async with contextlib.AsyncExitStack() as stack:
        camera = await opened_camera(config.camera, stack)
        here = Position(0.0, 0.0, config.mission.altitude_m)
        first = await camera.take_photo(here)
        photos = {first.source: first.jpeg}
        if config.camera.device is None:
            return Look(photos)
        await asyncio.sleep(_APART_S)
        second = await camera.take_photo(here)
    return Look(photos, tuple(_device_troubles(first.source, first.jpeg, second.jpeg)))


def _look_at_files(folder: Path) -> Look:
    files, until_s = photo_files(folder), time.monotonic() + _MOST_S
    chosen: dict[str, bytes] = {}
    bad: list[str] = []
    for looked_at, file in enumerate(files):
        if looked_at == _MOST_FILES or time.monotonic() > until_s:
            bad.append(f"only the first {looked_at} of {len(files)} photos of {folder} were looked at")
            break
        try:
            jpeg = read_photo_file(file)
        except CameraError as error:
            bad.append(str(error))
            continue
        if not any(segment.marker == EOI for segment in segments_of(jpeg)):
            bad.append(
                f"camera {folder}: {file.name} is no whole JPEG: copy it again, or take it out of the folder"
            )
        elif len(chosen) < 2 or len(jpeg) > len(chosen[_largest(chosen)]):
            if len(chosen) == 2:
                del chosen[list(chosen)[1]]
            chosen[file.name] = jpeg
    more = len(bad) - _MOST_NAMED
    return Look(chosen, (*bad[:_MOST_NAMED], *([f"and {more} more photos like these"] if more > 0 else [])))


def _largest(photos: Mapping[str, bytes]) -> str:
    return max(photos, key=lambda name: len(photos[name]))


def _device_troubles(camera: str, first: bytes, second: bytes) -> list[str]:
    import cv2
    import numpy as np

    if first == second:
        return [
            f"camera {camera}: two photos, taken {_APART_S:g} s apart, are the same: its picture stands still"
        ]
    picture = cv2.imdecode(np.frombuffer(second, np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None or picture.max() < _DARKEST:
        return [f"camera {camera}: its photo is black: take the cap off, or give it light"]
    return []
