"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a message to the user about it."""

from __future__ import annotations

from functools import partial

from upwash import CameraError, Drone, Waypoint
from upwash.services import Detection, Detector, Mode, NotAPhoto

_TRIES = 2  # of a photo, before the survey goes on without it


def survey(drone: Drone, mode: Mode = "heavy") -> None:
    """Visit the plan's waypoints and inspect a photo of each, before moving on or soon after.

    On rows the drone flies on, and turns back only for actions that take time. Where no photo can be inspected, the
    user gets a message, and the survey goes on.
    """
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = photo_at(drone, waypoint)
        if photo is not None:
            pending = drone.start(detector.process_photo, photo, mode=mode)
            failed = partial(notify_failure, drone, waypoint)
            if drone.on_rows and not drone.action_s:
                drone.when_answered(pending, partial(notify, drone, waypoint), failed=failed)
            else:
                drone.stay_or_go(pending, partial(act, drone, waypoint), failed=failed)
    drone.end_flight()
    drone.autopilot.disarm()


def photo_at(drone: Drone, waypoint: Waypoint) -> bytes | None:
    """A photo, tried twice; None, with a message to the user, if the camera gives none."""
    for left in reversed(range(_TRIES)):
        try:
            return drone.camera.take_photo()
        except CameraError as error:
            if not left:
                drone.user.notify(f"no photo: {error}", at=waypoint)
    return None


def notify_failure(drone: Drone, waypoint: Waypoint, error: Exception) -> None:
    """Notify the user of a photo that cannot be inspected; raises any other error."""
    if not isinstance(error, NotAPhoto):
        raise error
    drone.user.notify(f"no photo: {error}", at=waypoint)


def notify(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Notify the user of the findings at the waypoint; without findings there is no message."""
    if found:
        drone.user.notify(found, at=waypoint)


def act(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Notify the user of what was found at the waypoint, and hover there for the action."""
    drone.user.notify(found, at=waypoint)
    drone.autopilot.hover(drone.action_s)
