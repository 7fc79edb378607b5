"""A camera on a servo, as ArduPilot's AP_Camera_Servo triggers it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.geo import Position

_BUSY_S = 0.1  # CAM1_DURATION


@dataclass(frozen=True, slots=True)
class CameraShot:
    """One photo: its number, when and where it was taken."""

    number: int
    taken_s: float
    position: Position


class ServoCamera:
    """Takes photos, and keeps each until the vehicle has told everyone of it."""

    def __init__(self) -> None:
        self._shots = 0
        self._last_s = -math.inf
        self._untold: list[CameraShot] = []

    def shoot(self, now_s: float, position: Position) -> bool:
        """Takes a photo, unless the shutter is still held from the last one; whether it did."""
        if now_s < self._last_s + _BUSY_S:
            return False
        self._shots, self._last_s = self._shots + 1, now_s
        self._untold.append(CameraShot(self._shots, now_s, position))
        return True

    def told(self) -> list[CameraShot]:
        """The photos that nobody was told of yet."""
        untold, self._untold = self._untold, []
        return untold
