"""A service that no drone can run, and its mission: each photo waits for a server.

The drone reads the declaration alone, so that a large model is imported and loaded on the server only.
"""

from __future__ import annotations

from functools import partial

from upwash import Drone, service


@service(where="servers")
class Segmenter:
    """Segments photos by words, with a model that fills a server's graphics card."""

    def __init__(self, *, words: str = "crack, vegetation, bird nest") -> None:
        self._words = words.split(", ")

    def segment(self, photo: bytes) -> list[str]:
        """The words that a photo shows; here all of them where the photo is a JPEG, in place of a model."""
        return self._words if photo[:2] == b"\xff\xd8" else []


def survey(drone: Drone) -> None:
    """Take a photo at each waypoint, and tell the user what a server finds in it, as soon as one is in reach."""
    segmenter = drone.service(Segmenter, unanswered=None)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        pending = drone.start(segmenter.segment, drone.camera.take_photo())
        drone.stay_or_go(pending, partial(drone.user.notify, at=waypoint))
    drone.end_flight()
    drone.autopilot.disarm()
