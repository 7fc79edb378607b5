"""A stand-in PX4 when it is switched on."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.mavlink.version import Version
from upwash.vehicle.body.copter import StandInSettings

RECORDED_VERSION = Version(1, 16, 1)


@dataclass(frozen=True, slots=True)
class Px4Settings(StandInSettings):
    """A stand-in PX4. With `one_peer` it answers, over UDP, only the first peer until it is switched off."""

    armable_after_s: float = 4.0
    version: Version = RECORDED_VERSION
    one_peer: bool = False
