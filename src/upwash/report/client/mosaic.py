"""The photos laid over the ground, each where its corners lie: of each place the photo whose middle is nearest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upwash.report.crops import smaller

if TYPE_CHECKING:
    from cv2.typing import MatLike

LONGEST_PX = 1600
_FINE = 2.0  # times the pixels of the mosaic: how large a photo is before it is laid down
_LEAST_PX = 4.0  # of a photo, to each side


@dataclass(frozen=True, slots=True)
class Bounds:
    """A part of the ground, in metres east and north."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    @property
    def width_m(self) -> float:
        """From the west to the east."""
        return self.east_m - self.west_m

    @property
    def height_m(self) -> float:
        """From the south to the north."""
        return self.north_m - self.south_m


class Mosaic:
    """Lays photos over a part of the ground, north up; OpenCV is needed from the first photo on."""

    def __init__(self, bounds: Bounds) -> None:
        self.bounds = bounds
        self._px_per_m = LONGEST_PX / max(bounds.width_m, bounds.height_m)
        self._canvas: tuple[MatLike, MatLike] | None = None  # the pixels, and how near a photo's middle is

    def _blank(self) -> tuple[MatLike, MatLike]:
        import numpy as np

        sides_m = self.bounds.height_m, self.bounds.width_m
        size = [max(1, round(side_m * self._px_per_m)) for side_m in sides_m]
        return np.full((*size, 3), 255, np.uint8), np.zeros(size, np.float32)

    def lay(self, pixels: MatLike, corners_m: Sequence[tuple[float, float]]) -> None:
        """Lay down a photo whose corners lie there, clockwise from its upper left."""
        import cv2
        import numpy as np

        self._canvas = pixels_there, nearness_there = self._canvas or self._blank()
        west_north = np.array([self.bounds.west_m, self.bounds.north_m])
        corners = ((np.array(corners_m) - west_north) * (self._px_per_m, -self._px_per_m)).astype(np.float32)
        height, width = nearness_there.shape
        left, top = (max(0, math.floor(each)) for each in corners.min(axis=0))
        right, bottom = (
            min(most, math.ceil(each))
            for most, each in zip((width, height), corners.max(axis=0), strict=True)
        )
        across, down = (math.dist(corners[0], corners[other]) for other in (1, 3))
        if right <= left or bottom <= top or min(across, down) < _LEAST_PX:
            return
        shrunk = _shrunk(pixels, _FINE * max(across / pixels.shape[1], down / pixels.shape[0]))
        high, wide = shrunk.shape[:2]
        own = np.array([(0, 0), (wide, 0), (wide, high), (0, high)], np.float32)
        there = cv2.getPerspectiveTransform(own, corners - np.array([left, top], np.float32))
        size = right - left, bottom - top
        nearness = cv2.warpPerspective(_from_the_middle(wide, high), there, size)
        laid = cv2.warpPerspective(shrunk, there, size)
        part = slice(top, bottom), slice(left, right)
        nearer = nearness > nearness_there[part]
        pixels_there[part][nearer] = laid[nearer]
        nearness_there[part][nearer] = nearness[nearer]

    @property
    def jpeg(self) -> bytes | None:
        """The picture, white where no photo lies; None where none lies anywhere."""
        return smaller(self._canvas[0], 1.0) if self._canvas else None


def _shrunk(pixels: MatLike, scale: float) -> MatLike:
    import cv2

    if scale >= 1.0:
        return pixels
    return cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _from_the_middle(width: int, height: int) -> MatLike:
    """1 in the middle of a photo, and almost 0 at its edges."""
    import numpy as np

    across = np.abs(np.linspace(-1, 1, width, dtype=np.float32))
    down = np.abs(np.linspace(-1, 1, height, dtype=np.float32))
    return np.float32(1.001) - np.maximum(across[None, :], down[:, None])
