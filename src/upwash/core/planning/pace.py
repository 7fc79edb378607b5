"""How long a vehicle takes on average, for forecasts; `energy.WayHome` has what it takes at most.

    a leg        `legs.Leg` with this acceleration, and the settling
    a take-off   lifting + height / climb
    the return   the share of `energy.time_home_s`

Legs are from rest to rest at 2 to 10 m/s, and end within 1 m of the target at less than 0.5 m/s.
Tests hold the numbers against the vehicles' own motion and against recorded returns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Pace:
    """The average vehicle of a kind."""

    acceleration_m_s2: float = 1.0
    settling_s: float = 0.0  # of each leg: until it moves, and until it counts as arrived
    lifting_s: float = 0.0  # of each take-off, at any height
    climb_m_s: float = math.inf
    home_share: float = 1.0

    def takeoff_s(self, altitude_m: float) -> float:
        """From arming to that altitude above the ground."""
        return self.lifting_s + max(0.0, altitude_m) / self.climb_m_s


ARDUCOPTER = Pace(2.15, 0.4, lifting_s=5.9, climb_m_s=2.535, home_share=0.92)
PX4 = Pace(
    1.18, 2.45, lifting_s=6.8, climb_m_s=1.32, home_share=0.88
)  # as setpoints steer it (mavlink.course)
PACES: Mapping[str, Pace] = {"arducopter": ARDUCOPTER, "px4": PX4}
