"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a message to the user about it."""

from __future__ import annotations

from functools import partial

from upwash import AutopilotRefused, CameraError, Drone, FoundObject, Position, SecondLook, Waypoint
from upwash.services import Detection, Detector, Mode, NotAPhoto

_TRIES = 2  # of a photo, before the survey goes on without it


def survey(drone: Drone, mode: Mode = "heavy") -> None:
    """Visit the plan's waypoints and inspect a photo of each, before moving on or soon after.

    On rows the drone flies on, and leaves its way only for actions that take time and for second looks: once for each
    object, where the object lies. Where no photo can be inspected, the user gets a message, and the survey goes on.
    """
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = photo_at(drone, waypoint)
        if photo is not None:
            pending = drone.start(detector.process_photo, photo, mode=mode)
            tell, failed = partial(notify, drone, waypoint), partial(notify_failure, drone, waypoint)
            look, pose = drone.second_look, drone.camera.pose
            if look is not None:
                again = partial(look_again, drone, look, detector, mode)
                drone.act_once(pending, again, wanted=partial(is_wanted, look), tell=tell, failed=failed)
            elif drone.action_s and pose is not None and pose.gives_places:
                drone.act_once(pending, partial(act_on, drone), tell=tell, failed=failed)
            elif drone.on_rows and not drone.action_s:
                drone.when_answered(pending, tell, failed=failed)
            else:
                drone.stay_or_go(pending, partial(act, drone, waypoint), failed=failed)
    drone.end_flight()
    drone.autopilot.disarm()


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


def act(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Notify the user of what was found at the waypoint, and hover there for the action."""
    drone.user.notify(found, at=waypoint)
    drone.autopilot.hover(drone.action_s)


def act_on(drone: Drone, _: FoundObject) -> None:
    """Hover over an object for the action."""
    drone.autopilot.hover(drone.action_s)


def is_wanted(look: SecondLook, found: FoundObject) -> bool:
    """Whether the object gets a second look."""
    return look.wants(found.label, found.score)


def look_again(drone: Drone, look: SecondLook, detector: Detector, mode: Mode, found: FoundObject) -> None:
    """Take the second look: go down over the object, have a photo of it inspected, and come up again for the action.

    The drone does not wait for the answer. A look that a fence forbids is left out, with a message to the user.
    """
    low = found.over(look.altitude_m)
    try:
        drone.autopilot.goto(low)
    except AutopilotRefused as error:
        drone.user.notify(f"no second look at {found.label}: {error}", at=found.position)
    else:
        photo = photo_at(drone, low)
        if photo is not None:
            pending = drone.start(detector.process_photo, photo, mode=mode)
            told = partial(notify, drone, low)
            drone.when_answered(pending, told, failed=partial(notify_failure, drone, low))
        drone.autopilot.goto(found.position)
    drone.autopilot.hover(drone.action_s)
