"""ArduCopter's flight modes, and a stand-in ArduCopter when it is switched on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from upwash.errors import UsageError
from upwash.mavlink.version import Version
from upwash.vehicle.ardupilot.boot import RECORDED_S
from upwash.vehicle.ardupilot.failsafe import GLITCH_CLEARED_S, GLITCH_M
from upwash.vehicle.body.copter import StandInSettings

RECORDED_VERSION = Version(4, 7, kind=0)  # in development: with the parameters' names of 4.6
FASTEST_M_S = 300.0  # a report holds 327 m/s at most
_RATES = ("ground_speed_m_s", "climb_m_s", "descent_m_s", "return_speed_m_s", "speedup")


class CopterMode(IntEnum):
    """The flight modes that the stand-in knows, by ArduCopter's numbers."""

    STABILIZE = 0
    ALT_HOLD = 2
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


BY_POSITION = (CopterMode.GUIDED, CopterMode.LOITER, CopterMode.RTL, CopterMode.POSHOLD, CopterMode.BRAKE)
"""The modes that need to know the place."""


@dataclass(frozen=True, slots=True)
class VehicleSettings(StandInSettings):
    """A stand-in ArduCopter: where it stands and how it flies.

    It flies as a recorded ArduCopter did. With an acceleration it speeds up and brakes at that rate, climbs
    and descends at the given speeds, does not spool up and does not hover above its home.
    """

    armable_after_s: float = RECORDED_S
    version: Version = RECORDED_VERSION
    acceleration_m_s2: float | None = None
    climb_m_s: float = 2.5
    descent_m_s: float = 1.5
    ground_speed_m_s: float = 5.4  # of legs without a commanded speed
    return_speed_m_s: float = 10.0
    return_altitude_m: float = 15.0
    auto_disarm_s: float = 2.0
    clock_offset_s: float | None = 0.0  # of its GPS's time from this computer's; None: it tells no time
    glitch_m: float = GLITCH_M  # north, the error of GPS in a glitch
    glitch_cleared_after_s: float = GLITCH_CLEARED_S  # the glitch counts as over then, though it lasts

    def __post_init__(self) -> None:
        StandInSettings.__post_init__(self)
        rates = {name: getattr(self, name) for name in _RATES}
        if self.acceleration_m_s2 is not None:
            rates["acceleration_m_s2"] = self.acceleration_m_s2
        for name, rate in rates.items():
            if not 0 < rate <= FASTEST_M_S:
                raise UsageError(f"vehicle: {name} is {rate}; give a number above 0, at most {FASTEST_M_S:g}")
        if not math.isfinite(self.glitch_m):
            raise UsageError(f"vehicle: glitch_m is {self.glitch_m}; give a number of metres")
        if not self.glitch_cleared_after_s > 0:
            raise UsageError(
                f"vehicle: glitch_cleared_after_s is {self.glitch_cleared_after_s}; give a number above 0, or inf"
            )
