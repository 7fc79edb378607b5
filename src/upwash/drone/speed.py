"""The ground speed of a mission of rows: what limits it, and what it leads to.

A speed that is chosen moves the ground by half a pixel at most during an exposure: the finest detail that a photo can
have keeps 90 % of its contrast then. A speed that a person chose is warned of above one pixel, which keeps 64 %. With
a blur of b pixels the contrast of the finest detail is sin(pi b / 2) / (pi b / 2).
"""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.photo_ground import photo_ground
from upwash.config.plan_photos import photo_legs

SHARP_PX, BLURRED_PX = 0.5, 1.0


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
