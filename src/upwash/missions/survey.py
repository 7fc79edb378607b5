"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a word to the user about what is on it."""

from __future__ import annotations

from upwash import Drone
from upwash.services import Detector, Mode


def survey(drone: Drone, mode: Mode = "heavy") -> None:
    """Visits the plan's waypoints and has every photo looked at before moving on."""
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = drone.camera.take_photo()
        found = detector.process_photo(photo, mode=mode)
        if found:
            drone.user.notify(found, at=waypoint)
    drone.end_flight()
    drone.autopilot.disarm()
