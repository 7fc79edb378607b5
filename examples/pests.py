"""Counts beetles on leaves: one interface, a quick implementation for the drone and a thorough one for the server.

What follows is the drone's; the server's is in pests_on_server.py. The mission cannot tell which of them answered.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from upwash import Drone, service

MANY = 20


@dataclass
class Beetles:
    """How many there are in a photo, and whether each was looked at or the number was estimated."""

    number: int
    counted: bool


@service
class BeetleCounter:
    """Estimates: at a quarter of the size beetles run into each other, so their area is what counts."""

    usual_area_px = 10.0  # of one beetle, at that size

    def count(self, photo: bytes) -> Beetles:
        """How many beetles are in the photo."""
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), cv2.IMREAD_REDUCED_COLOR_4)
        if image is None:
            raise ValueError("this is no photo")
        return Beetles(round(cv2.countNonZero(red(image)) / self.usual_area_px), counted=False)


def red(image: np.ndarray) -> np.ndarray:
    """The pixels that are far more red than green and blue, as a mask."""
    blue, green, red = (image[:, :, channel].astype(np.int16) for channel in range(3))
    return ((red - np.maximum(green, blue)) > 60).astype(np.uint8)


def scout(drone: Drone) -> None:
    """Visits every waypoint and tells the user where there are many."""
    counter = drone.service(BeetleCounter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        beetles = counter.count(drone.camera.take_photo())
        if beetles.number >= MANY:
            drone.user.notify(beetles, at=waypoint)
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
