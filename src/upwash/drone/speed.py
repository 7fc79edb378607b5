"""The ground speed of a mission of rows: what limits it, and what it leads to.

A speed that is chosen moves the ground by half a pixel at most during an exposure: the finest detail that a photo can
have keeps 90 % of its contrast then. A speed that a person chose is warned of above one pixel, which keeps 64 %. With
a blur of b pixels the contrast of the finest detail is sin(pi b / 2) / (pi b / 2).

On level ground a pixel shows altitude / focal length in pixels, straight below. The nose points along the row: the
height of a photo lies along the flight, its width with the camera turned by 90 degrees; in between the shorter side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import Struct

from upwash.config.drone import CameraConfig, DroneConfig
from upwash.config.plan_photos import photo_legs

SHARP_PX, BLURRED_PX = 0.5, 1.0
_STRAIGHT_DEG = 1e-6


class SpeedLimit(Struct, frozen=True):
    """The highest speed by one rule, and what sets it, such as "the camera"."""

    by: str
    ground_speed_m_s: float


def speed_limits(config: DroneConfig) -> Iterator[SpeedLimit]:
    """The limits of a speed that is chosen, for a mission of rows."""
    legs, camera = photo_legs(config.mission), config.camera
    pixel_m = photo_ground(config, min((leg.altitude_m for leg in legs), default=None)).pixel_m
    if pixel_m is not None and camera.exposure_s is not None:
        yield SpeedLimit("blur", SHARP_PX * pixel_m / camera.exposure_s)
    if legs and camera.photo_s > 0:
        yield SpeedLimit("the camera", min(leg.step_m for leg in legs) / camera.photo_s)
    yield SpeedLimit("mission.ground_speed_m_s", config.mission.ground_speed_m_s)


def photo_doubts(config: DroneConfig) -> Iterator[tuple[str, str]]:
    """Warnings of photos taken in flight, each a kind and a sentence; of blur only where the speed is given."""
    legs, camera = photo_legs(config.mission), config.camera
    if not legs:
        return
    fastest = max(legs, key=lambda leg: leg.ground_speed_m_s / leg.altitude_m)  # over the ground of a photo
    ground = photo_ground(config, fastest.altitude_m)
    if ground.pixel_m is not None and camera.exposure_s is not None and config.mission.speed == "given":
        moved_px = fastest.ground_speed_m_s * camera.exposure_s / ground.pixel_m
        if moved_px > BLURRED_PX:
            allowed_m_s = BLURRED_PX * ground.pixel_m / camera.exposure_s
            yield (
                "blur",
                f"the ground moves by {moved_px:.1f} pixels during an exposure of {camera.exposure_s:g} s: at "
                f"{allowed_m_s:.2g} m/s it is one pixel; fly slower, or expose for a shorter time",
            )
    widest = max(legs, key=lambda leg: leg.step_m / leg.altitude_m)
    ground, step_m = photo_ground(config, widest.altitude_m), widest.step_m
    if ground.along_m is not None and step_m > ground.along_m:
        yield (
            "gaps",
            f"a photo shows {ground.along_m:.1f} m of a row, so that one every {step_m:g} m leaves gaps of "
            f"{step_m - ground.along_m:.1f} m: take photos more often, or fly higher, unless spots are enough",
        )


class PhotoGround(Struct, frozen=True, kw_only=True):
    """The ground in a pixel and along the flight, in metres; None with the reason, and the key that would tell it."""

    pixel_m: float | None = None
    along_m: float | None = None
    why_no_pixel: str = ""
    why_no_length: str = ""


def photo_ground(config: DroneConfig, altitude_m: float | None = None) -> PhotoGround:
    """The ground in a photo at an altitude, by default the mission's."""
    camera, altitude_m = config.camera, altitude_m or config.mission.altitude_m
    if camera.park_seed is not None:
        return _unknown("photos of camera.park_seed are rendered")
    if camera.calibration is not None:
        return _unknown("camera.calibration is not read for it: fov_deg or focal_px in its place tells it")
    if camera.fov_deg is None and camera.focal_px is None:
        return _unknown("the lens is unknown: give camera.fov_deg and camera.photo_px")
    if camera.photo_px is None:
        size = "the size of a photo is unknown: give camera.photo_px"
        if camera.focal_px is None:
            return _unknown(size)
        return PhotoGround(pixel_m=altitude_m / camera.focal_px, why_no_length=size)
    focal_px = camera.focal_px
    if focal_px is None:
        focal_px = camera.photo_px[0] / 2 / math.tan(math.radians(camera.fov_deg or 0.0) / 2)
    pixel_m = altitude_m / focal_px
    if abs(camera.tilt_deg - 90) > _STRAIGHT_DEG:
        why = "the camera does not look straight down (camera.tilt_deg)"
        return PhotoGround(pixel_m=pixel_m, why_no_length=why)
    return PhotoGround(pixel_m=pixel_m, along_m=pixel_m * _side_px(camera))


def _unknown(why: str) -> PhotoGround:
    return PhotoGround(why_no_pixel=why, why_no_length=why)


def _side_px(camera: CameraConfig) -> float:
    width_px, height_px = camera.photo_px or (0, 0)
    turned_deg = abs(camera.yaw_deg)
    if turned_deg not in (0, 90, 180):
        return min(width_px, height_px)
    return width_px if turned_deg == 90 else height_px
