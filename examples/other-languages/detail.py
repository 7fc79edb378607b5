"""How much detail a photo has: a service that the drone computes in Python and a server in C++ (detail.cpp)."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from upwash import Drone, service


@dataclass
class Reading:
    """What was found in a photo."""

    bits_per_byte: float
    is_blank: bool


@service
class Detail:
    """The entropy of a photo's bytes; one of less than `blank_below` shows nothing."""

    def __init__(self, *, blank_below: float = 1.0) -> None:
        self.blank_below = blank_below

    def measure(self, photo: bytes) -> Reading:
        """Bits that each byte tells, from 0 to 8; ValueError for an empty photo."""
        if not photo:
            raise ValueError("the photo is empty")
        shares = [count / len(photo) for count in Counter(photo).values()]
        bits = -sum(share * math.log2(share) for share in shares)
        return Reading(bits, bits < self.blank_below)


def survey(drone: Drone) -> None:
    """Visits every waypoint and tells the user how much detail its photo has."""
    detail = drone.service(Detail)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.user.notify(detail.measure(drone.camera.take_photo()), at=waypoint)
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
