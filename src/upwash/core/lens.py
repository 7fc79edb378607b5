"""What a photo shows of the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Position


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera that looks straight down; `fov_deg` is its horizontal field of view.

    `up_deg` is the direction that is up in a photo, clockwise from north; None means the vehicle's nose.
    """

    fov_deg: float
    up_deg: float | None = None

    def footprint_m(
        self, at: Position, size_px: tuple[int, int], nose_deg: float | None
    ) -> list[tuple[float, float]] | None:
        """The corners of the photo on level ground at home's altitude, east and north of home, in metres.

        They are clockwise from the photo's upper left. None means that they are unknown: the vehicle does not report
        its nose's direction, or is not above home's altitude.
        """
        up_deg = nose_deg if self.up_deg is None else self.up_deg
        if up_deg is None or at.altitude_m <= 0 or min(size_px) <= 0:
            return None
        right_m = at.altitude_m * math.tan(math.radians(self.fov_deg) / 2)
        up_m = right_m * size_px[1] / size_px[0]
        sine, cosine = math.sin(math.radians(up_deg)), math.cos(math.radians(up_deg))
        return [
            (at.east_m + right * cosine + up * sine, at.north_m - right * sine + up * cosine)
            for right, up in ((-right_m, up_m), (right_m, up_m), (right_m, -up_m), (-right_m, -up_m))
        ]
