"""Photos of a camera at the autopilot, by its reports: CAMERA_FEEDBACK (ArduPilot), CAMERA_IMAGE_CAPTURED (PX4).

Both tell where the vehicle was at the shutter. A camera with a MAVLink component of its own is not heard.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame, rounded
from upwash.core.vehicle.telemetry import gps_time
from upwash.eventlog.schema import AutopilotPhoto
from upwash.mavlink.packets import Message
from upwash.real.mavlink.telemetry import VehicleTelemetry, place_of_e7

_NO_PLACE = 0, 0  # a latitude and a longitude
_FAILED = 0  # PX4's capture_result; -1 is a camera that does not say
_OTHERS = mavlink.CAMERA_FEEDBACK_VIDEO, mavlink.CAMERA_FEEDBACK_BADEXPOSURE
_DIGITS = 7


class ShutterReports:
    """Tells each photo that the autopilot reports, once."""

    def __init__(
        self, tell: Callable[[AutopilotPhoto], None], telemetry: VehicleTelemetry, frame: LocalFrame
    ) -> None:
        self._tell = tell
        self._telemetry = telemetry
        self._frame = frame
        self._last: tuple[int, int] | None = None  # a camera and the number of its photo

    def hear(self, message: Message) -> None:
        """Take in a message of the vehicle."""
        match message.get_type():
            case "CAMERA_FEEDBACK" if message.flags not in _OTHERS:
                geo = place_of_e7(message.lat, message.lng, message.alt_msl)
                self._take((message.cam_idx, message.img_idx), geo, message.time_usec / 1e6)
            case "CAMERA_IMAGE_CAPTURED" if message.capture_result != _FAILED:
                geo = place_of_e7(message.lat, message.lon, message.alt / 1e3)
                self._take((message.camera_id, message.image_index), geo, message.time_utc / 1e6)

    def _take(self, shot: tuple[int, int], geo: GeoPosition, unix_s: float) -> None:
        """Tell the photo of a camera and number, unless it is the last one, at a place above the sea."""
        if shot == self._last:
            return
        self._last = shot
        photo = AutopilotPhoto(camera=shot[0], number=max(0, shot[1]), taken=_date(unix_s))
        self._tell(photo if (geo.latitude_deg, geo.longitude_deg) == _NO_PLACE else self._placed(photo, geo))

    def _placed(self, photo: AutopilotPhoto, geo: GeoPosition) -> AutopilotPhoto:
        altitude_m = geo.altitude_m - self._telemetry.home_above_sea_m
        return msgspec.structs.replace(
            photo,
            position=rounded(self._frame.position(geo).at_altitude(altitude_m)),
            latitude_deg=round(geo.latitude_deg, _DIGITS),
            longitude_deg=round(geo.longitude_deg, _DIGITS),
            above_sea_m=round(geo.altitude_m, 2),
        )


def _date(unix_s: float) -> datetime | None:
    return None if gps_time(unix_s) is None else datetime.fromtimestamp(unix_s, UTC)
