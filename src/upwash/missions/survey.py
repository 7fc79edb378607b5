"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a word to the user about what is on it."""

from __future__ import annotations

from functools import partial

from upwash import Drone, Waypoint
from upwash.services import Detection, Detector, Mode


def survey(drone: Drone, mode: Mode = "heavy") -> None:
    """Visits the plan's waypoints and has every photo looked at, before it moves on or soon after."""
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = drone.camera.take_photo()
        pending = drone.start(detector.process_photo, photo, mode=mode)
        drone.stay_or_go(pending, partial(tell, drone, waypoint))
    drone.end_flight()
    drone.autopilot.disarm()


def tell(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Tells the user what was found at the waypoint, and stays there for them to look at it."""
    drone.user.notify(found, at=waypoint)
    drone.autopilot.hover(drone.action_s)
