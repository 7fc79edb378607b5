"""What bundled missions do with a photo and its answer: try twice, and tell the user."""

from __future__ import annotations

from upwash import CameraError, Drone, Position, Waypoint
from upwash.services import Detection, NotAPhoto

_TRIES = 2  # of a photo, before the survey goes on without it


def photo_at(drone: Drone, place: Waypoint | Position) -> bytes | None:
    """A photo, tried twice; None, with a message to the user, if the camera gives none."""
    for left in reversed(range(_TRIES)):
        try:
            return drone.camera.take_photo()
        except CameraError as error:
            if not left:
                drone.user.notify(f"no photo: {error}", at=place)
    return None


def notify_failure(drone: Drone, place: Waypoint | Position, error: Exception) -> None:
    """Notify the user of a photo that cannot be inspected; raises any other error."""
    if not isinstance(error, NotAPhoto):
        raise error
    drone.user.notify(f"no photo: {error}", at=place)


def notify(drone: Drone, place: Waypoint | Position, found: list[Detection]) -> None:
    """Notify the user of the findings at the place; without findings there is no message."""
    if found:
        drone.user.notify(found, at=place)
