"""The drone's payload as a mission uses it: the camera, and devices that obey MAVLink commands."""

from __future__ import annotations

import asyncio
import math

import msgspec

from upwash.core.geo import EarthPosition, rounded
from upwash.core.vehicle.payload import (
    DO_DIGICAM_CONTROL,
    DO_GIMBAL_MANAGER_PITCHYAW,
    IMAGE_START_CAPTURE,
    MOST_PARAMETERS,
    PAYLOAD_COMMANDS,
)
from upwash.drone.mission import MissionThread
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.ports import Autopilot, Camera, Journal
from upwash.support.exif import PhotoPlace, with_place
from upwash.support.jpeg import size_of

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
        """Takes a photo and returns it as a JPEG, with its place on the Earth as EXIF if known; raises CameraError.

        A photo with a place from the camera's own GPS is returned unchanged.
        """
        return self._thread.call(self._take_photo())

    async def _take_photo(self) -> bytes:
        vehicle = self._autopilot
        at, earth, heading_deg = vehicle.position, vehicle.earth_position, vehicle.telemetry.heading_deg
        photo = await self._camera.take_photo(at)
        size_px = size_of(photo.jpeg) if photo.lens else None
        footprint_m = photo.lens.footprint_m(at, size_px, heading_deg) if photo.lens and size_px else None
        jpeg = photo.jpeg if earth is None else with_place(photo.jpeg, _shot(earth, heading_deg))
        self._journal.record(
            schema.PhotoTaken(
                source=photo.source,
                bytes=len(jpeg),
                age_s=round(asyncio.get_running_loop().time() - photo.captured_s, 6),
                position=rounded(at),
                latitude_deg=None if earth is None else round(earth.latitude_deg, _DIGITS),
                longitude_deg=None if earth is None else round(earth.longitude_deg, _DIGITS),
                above_sea_m=None if earth is None else _to_the_centimetre(earth.above_sea_m),
                footprint_m=footprint_m
                and [(round(east, 2), round(north, 2)) for east, north in footprint_m],
                truth=msgspec.to_builtins(photo.truth),
            )
        )
        return jpeg


def _shot(earth: EarthPosition, heading_deg: float | None) -> PhotoPlace:
    return PhotoPlace(earth.latitude_deg, earth.longitude_deg, earth.above_sea_m, heading_deg, earth.unix_s)


def _to_the_centimetre(length_m: float | None) -> float | None:
    return None if length_m is None else round(length_m, 2)


_SHOTS = (DO_DIGICAM_CONTROL, IMAGE_START_CAPTURE)
_BETWEEN_SHOTS_S = 0.5  # more than ArduPilot's CAM1_DURATION, 0.1 s by default
_SHOOT = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)


class Payload:
    """Gimbal, camera trigger, servos and other devices; methods return when the vehicle has accepted the command.

    Each raises AutopilotRefused if the vehicle has no such device, and AutopilotOverruled if the program has lost the
    vehicle.
    """

    def __init__(self, autopilot: Autopilot, thread: MissionThread, journal: Journal) -> None:
        self._autopilot = autopilot
        self._thread = thread
        self._journal = journal
        self._shoots_again_s = -math.inf

    def point_gimbal(self, *, pitch_deg: float, yaw_deg: float = 0.0) -> None:
        """Turns the gimbal: -90 looks straight down, 0 ahead; the yaw is relative to the vehicle's nose.

        Does not wait for the gimbal. Raises UsageError for a pitch beyond ±90 or a yaw beyond ±180 degrees.
        """
        for name, value, most in (("pitch_deg", pitch_deg, 90), ("yaw_deg", yaw_deg, 180)):
            if not abs(value) <= most:
                raise UsageError(f"point_gimbal: {name} is {value}: give degrees from -{most} to {most}")
        self.command(DO_GIMBAL_MANAGER_PITCHYAW, pitch_deg, yaw_deg, math.nan, math.nan)

    def trigger_camera(self) -> None:
        """Triggers the camera that is connected to the autopilot; the mission does not get the photo.

        A second trigger within 0.5 s waits: an ArduCopter accepts a trigger while the shutter is still held, and
        takes no photo.
        """
        self.command(DO_DIGICAM_CONTROL, *_SHOOT)

    def command(self, number: int, *parameters: float) -> None:
        """Sends a MAVLink command of a payload with up to seven parameters; the others are 0.

        Raises UsageError for a command that could move, arm or reconfigure the vehicle; docs/missions.md lists those
        that may be sent.
        """
        if number not in PAYLOAD_COMMANDS:
            raise UsageError(
                f"MAVLink command {number} is not sent: only commands of payloads are, such as 183 (DO_SET_SERVO) or "
                "31010 to 31014 (of your own). Fly with drone.autopilot"
            )
        if len(parameters) > MOST_PARAMETERS:
            raise UsageError(
                f"MAVLink command {number}: {len(parameters)} parameters, and a command has at most {MOST_PARAMETERS}"
            )
        self._thread.call(self._command(number, parameters))

    async def _command(self, number: int, parameters: tuple[float, ...]) -> None:
        name = PAYLOAD_COMMANDS[number]
        if number in _SHOTS:
            await asyncio.sleep(max(0.0, self._shoots_again_s - asyncio.get_running_loop().time()))
        await self._autopilot.command(number, name, parameters)
        if number in _SHOTS:
            self._shoots_again_s = asyncio.get_running_loop().time() + _BETWEEN_SHOTS_S
        self._journal.record(
            schema.PayloadCommanded(
                number=number,
                name=name,
                parameters=[value if math.isfinite(value) else None for value in parameters],
            )
        )
