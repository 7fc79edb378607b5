"""A camera's lens and its mount: from a pixel to a direction from the vehicle.

Directions in a photo are those of OpenCV's pinhole model: x to the right, y down, z along the optical axis.
"""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import msgspec

Vector: TypeAlias = tuple[float, float, float]
Size: TypeAlias = tuple[int, int]
_Length = Annotated[float, msgspec.Meta(gt=0, le=1e6)]
_Angle = Annotated[float, msgspec.Meta(ge=-360, le=360)]
_STEPS = 20  # of the iteration that takes the distortion out
_CLOSE = 1e-9
_SAME_RATIO = 0.01  # as of pictures of 1640 x 1232 and 640 x 480 pixels of one sensor


class Lens(msgspec.Struct, frozen=True, omit_defaults=True):
    """The lens, by its horizontal field of view or its focal length in pixels of the photo, and how it is mounted.

    `centre` is where the optical axis meets the photo, in shares of its width and height. `distortion` has k1, k2,
    p1, p2 and k3 of OpenCV's model. `tilt_deg` is how far below the horizon a level vehicle's camera looks, and
    `turned_deg` how far right of the nose. `up_deg` is the direction that is up in every photo, clockwise from north,
    for a camera that is always level; None means that the camera moves with the vehicle. `on_gimbal` says that a
    gimbal keeps it level. `scale_error` is the standard error of the focal length, as a share. `ratio` is the width
    of the calibrated pictures by their height; it may be unknown.
    """

    fov_deg: Annotated[float, msgspec.Meta(ge=1, le=170)] | None = None
    focal_px: _Length | None = None
    centre: tuple[float, float] = (0.5, 0.5)
    distortion: Annotated[tuple[float, ...], msgspec.Meta(max_length=5)] = ()
    tilt_deg: _Angle = 90.0
    turned_deg: _Angle = 0.0
    up_deg: _Angle | None = None
    on_gimbal: bool = False
    scale_error: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.01
    ratio: Annotated[float, msgspec.Meta(gt=0)] | None = None

    def fits(self, size_px: Size) -> bool:
        """Whether a photo of that size shows what the calibrated pictures show, at any scale."""
        return self.ratio is None or abs(size_px[0] / size_px[1] / self.ratio - 1) <= _SAME_RATIO

    def focal_in(self, size_px: Size) -> float:
        """The focal length in pixels of a photo of that size."""
        if self.focal_px is not None:
            return self.focal_px
        return size_px[0] / 2 / math.tan(math.radians(self.fov_deg or 60.0) / 2)

    def direction(self, x_px: float, y_px: float, size_px: Size) -> tuple[float, float] | None:
        """The direction of a pixel: x and y of a vector whose z is 1; None where the distortion fits no direction."""
        focal_px = self.focal_in(size_px)
        seen_x = (x_px - self.centre[0] * size_px[0]) / focal_px
        seen_y = (y_px - self.centre[1] * size_px[1]) / focal_px
        if not self.distortion:
            return seen_x, seen_y
        k1, k2, p1, p2, k3 = (*self.distortion, *(0.0,) * (5 - len(self.distortion)))
        x, y = seen_x, seen_y
        for _ in range(_STEPS):
            square = x * x + y * y
            scale = 1 + square * (k1 + square * (k2 + square * k3))
            if scale <= 0:
                return None
            shift_x = 2 * p1 * x * y + p2 * (square + 2 * x * x)
            shift_y = 2 * p2 * x * y + p1 * (square + 2 * y * y)
            x, y, last_x, last_y = (seen_x - shift_x) / scale, (seen_y - shift_y) / scale, x, y
            if abs(x - last_x) + abs(y - last_y) < _CLOSE:
                return x, y
        return None

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Right, down and ahead in the photo, each forward, right and down from the vehicle."""
        tilt, turned = math.radians(self.tilt_deg), math.radians(self.turned_deg)
        low, level = math.sin(tilt), math.cos(tilt)
        sine, cosine = math.sin(turned), math.cos(turned)
        return (
            (-sine, cosine, 0.0),
            (-low * cosine, -low * sine, level),
            (level * cosine, level * sine, low),
        )
