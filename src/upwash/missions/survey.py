"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a word to the user about what is on it."""

from __future__ import annotations

from functools import partial

from upwash import CameraError, Drone, Waypoint
from upwash.services import Detection, Detector, Mode, NotAPhoto

_TRIES = 2  # of a photo, before the survey goes on without it


def survey(drone: Drone, mode: Mode = "heavy") -> None:
    """Visits the plan's waypoints and has every photo looked at, before it moves on or soon after.

    The user is told of a waypoint without a photo that can be looked at, and the survey goes on.
    """
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = photo_at(drone, waypoint)
        if photo is not None:
            pending = drone.start(detector.process_photo, photo, mode=mode)
            drone.stay_or_go(
                pending, partial(tell, drone, waypoint), failed=partial(tell_failure, drone, waypoint)
            )
    drone.end_flight()
    drone.autopilot.disarm()


def photo_at(drone: Drone, waypoint: Waypoint) -> bytes | None:
    """A photo, taken again where the camera gives none; None, of which the user is told, where it still does not."""
    for left in reversed(range(_TRIES)):
        try:
            return drone.camera.take_photo()
        except CameraError as error:
            if not left:
                drone.user.notify(f"no photo: {error}", at=waypoint)
    return None


def tell_failure(drone: Drone, waypoint: Waypoint, error: Exception) -> None:
    """Tells the user of a photo that cannot be looked at; raises whatever else failed."""
    if not isinstance(error, NotAPhoto):
        raise error
    drone.user.notify(f"no photo: {error}", at=waypoint)


def tell(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Tells the user what was found at the waypoint, and stays there for them to look at it."""
    drone.user.notify(found, at=waypoint)
    drone.autopilot.hover(drone.action_s)
