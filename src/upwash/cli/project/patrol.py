"""A mission, and the service that it calls."""

from dataclasses import dataclass

from upwash import Drone, service


@dataclass
class Inspection:
    """What the service says of a photo."""

    brightness: float  # mean of all pixels, from 0 to 255
    bright_spots: int


@service
class Inspector:
    """Looks for bright spots. Each call runs on the drone or on a server, whichever answers sooner."""

    def __init__(self, *, threshold: int = 230) -> None:
        """Slow imports and models belong here: it runs once, when the service is started."""
        import cv2

        self._cv2 = cv2
        self._threshold = threshold

    def inspect(self, photo: bytes) -> Inspection:
        """Takes a JPEG."""
        import numpy as np

        cv2 = self._cv2
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ValueError("this is not a photo")
        bright = (image > self._threshold).astype(np.uint8)
        spots, _ = cv2.connectedComponents(bright)
        return Inspection(float(image.mean()), spots - 1)  # the background counts as one


def patrol(drone: Drone) -> None:
    """Inspects every waypoint and tells the user what was found there."""
    inspector = drone.service(Inspector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)  # returns on arrival
        inspection = inspector.inspect(drone.camera.take_photo())
        drone.user.notify(inspection, at=waypoint)
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
