"""ArduCopter's flight modes, by its numbers."""

from __future__ import annotations

from enum import IntEnum


class Mode(IntEnum):
    """The flight modes that the stand-in knows, by ArduCopter's numbers."""

    STABILIZE = 0
    ALT_HOLD = 2
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


BY_POSITION = (Mode.GUIDED, Mode.LOITER, Mode.RTL, Mode.POSHOLD, Mode.BRAKE)
"""Those that need to know the place."""
