"""What a photo of the configured camera shows of level ground, as far as the file says.

A pixel shows altitude / focal length in pixels, straight below. The nose points along the row: the height of a photo
lies along the flight, its width with the camera turned by 90 degrees; in between the shorter side counts.
"""

from __future__ import annotations

import math

from msgspec import Struct

from upwash.config.drone import CameraConfig, DroneConfig

_STRAIGHT_DEG = 1e-6


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
