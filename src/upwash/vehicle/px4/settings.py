"""What a stand-in PX4 is like when it is switched on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.mavlink.version import Version
from upwash.vehicle.body.condition import VehicleFault

RECORDED_VERSION = Version(1, 16, 1)


@dataclass(frozen=True, slots=True)
class Px4Settings:
    """A PX4 multicopter: where it stands, and what it is like at boot.

    With `one_peer` it answers, over UDP, only the first who spoke to it, until it is switched off.
    """

    home: GeoPosition
    home_altitude_m: float = 0.0  # above the sea
    armable_after_s: float = 4.0
    battery_percent: float = 100.0
    endurance_s: float = 1_200.0  # of a full battery with the motors running
    version: Version = RECORDED_VERSION
    speedup: float = 1.0  # of its clock, against everyone else's
    faults: tuple[VehicleFault, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    one_peer: bool = False

    def __post_init__(self) -> None:
        for name in ("endurance_s", "speedup"):
            if not 0 < getattr(self, name) < math.inf:
                raise UsageError(f"vehicle: {name} is {getattr(self, name)}; give a number above 0")
        if not self.armable_after_s >= 0:
            raise UsageError(f"vehicle: armable_after_s is {self.armable_after_s}; give a number from 0 on")
        if not 0 <= self.battery_percent <= 100:
            raise UsageError(f"vehicle: battery_percent is {self.battery_percent}; give 0 to 100")
        if not math.isfinite(self.home_altitude_m):
            raise UsageError(f"vehicle: home_altitude_m is {self.home_altitude_m}; give a number of metres")
