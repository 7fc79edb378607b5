"""Reads QR codes in photos, with OpenCV: a service that needs Python packages of its own."""

import cv2
import numpy as np

from upwash import Drone, service


@service
class Markers:
    """Reads what is written in QR codes."""

    def __init__(self) -> None:
        self._detector = cv2.QRCodeDetector()

    def read(self, photo: bytes) -> list[str]:
        """The texts of the codes in a JPEG; empty where there are none."""
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ValueError("this is not a photo")
        _, texts, _, _ = self._detector.detectAndDecodeMulti(image)
        return [text for text in texts if text]


def find_markers(drone: Drone) -> None:
    """Visits every waypoint and tells the user which codes it sees there."""
    markers = drone.service(Markers)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        texts = markers.read(drone.camera.take_photo())
        if texts:
            drone.user.notify(texts, at=waypoint)
    drone.autopilot.return_home_and_land()
