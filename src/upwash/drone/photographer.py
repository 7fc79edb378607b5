"""The camera as a mission uses it: photos that know where on the Earth they were taken."""

from __future__ import annotations

import asyncio

import msgspec

from upwash.core.geo import EarthPosition, rounded
from upwash.drone.mission import MissionThread
from upwash.eventlog import schema
from upwash.ports import Autopilot, Camera, Journal
from upwash.support.exif import Shot, with_place

_DIGITS = 7  # of a degree: about a centimetre


class Photographer:
    """The camera as a mission uses it."""

    def __init__(
        self, camera: Camera, thread: MissionThread, journal: Journal, *, autopilot: Autopilot
    ) -> None:
        self._camera = camera
        self._thread = thread
        self._journal = journal
        self._autopilot = autopilot

    def take_photo(self) -> bytes:
        """Shoots and returns one JPEG, with its place on the Earth as EXIF where that is known; raises CameraError.

        A photo with a place from the camera's own GPS is returned unchanged.
        """
        return self._thread.call(self._take_photo())

    async def _take_photo(self) -> bytes:
        vehicle = self._autopilot
        at, earth, heading_deg = vehicle.position, vehicle.earth_position, vehicle.heading_deg
        photo = await self._camera.take_photo(at)
        jpeg = photo.jpeg if earth is None else with_place(photo.jpeg, _shot(earth, heading_deg))
        self._journal.record(
            schema.Photo(
                source=photo.source,
                bytes=len(jpeg),
                age_s=round(asyncio.get_running_loop().time() - photo.captured_s, 6),
                position=rounded(at),
                latitude_deg=None if earth is None else round(earth.latitude_deg, _DIGITS),
                longitude_deg=None if earth is None else round(earth.longitude_deg, _DIGITS),
                above_sea_m=None if earth is None else _to_the_centimetre(earth.above_sea_m),
                truth=msgspec.to_builtins(photo.truth),
            )
        )
        return jpeg


def _shot(earth: EarthPosition, heading_deg: float | None) -> Shot:
    return Shot(earth.latitude_deg, earth.longitude_deg, earth.above_sea_m, heading_deg, earth.unix_s)


def _to_the_centimetre(length_m: float | None) -> float | None:
    return None if length_m is None else round(length_m, 2)
