"""The thesis's mission (its algorithm 1): a photo at every waypoint, and a message to the user about it."""

from __future__ import annotations

from functools import partial

from upwash import Drone, FoundObject, Waypoint
from upwash.missions.photos import notify, notify_failure, photo_at
from upwash.missions.second_look import look_again
from upwash.services import Detection, Detector, Mode


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
            if acts_on_objects(drone):
                on_object = partial(act_on, drone, detector, mode)
                wanted = partial(acts_on, drone)
                drone.act_once(pending, on_object, wanted=wanted, tell=tell, failed=failed)
            elif drone.on_rows and not drone.action_s:
                drone.when_answered(pending, tell, failed=failed)
            else:
                drone.stay_or_go(pending, partial(act, drone, waypoint), failed=failed)
    drone.end_flight()
    drone.autopilot.disarm()


def acts_on_objects(drone: Drone) -> bool:
    """Whether the drone has something to do at objects, and knows where these lie."""
    pose = drone.camera.pose
    return drone.second_look is not None or (drone.action_s > 0 and pose is not None and pose.gives_places)


def acts_on(drone: Drone, found: FoundObject) -> bool:
    """Whether the drone has something to do at the object."""
    return drone.second_look is None or drone.second_look.wants(found.label, found.score)


def act_on(drone: Drone, detector: Detector, mode: Mode, found: FoundObject) -> None:
    """Take the second look at an object, if one is configured, and hover there for the action."""
    if drone.second_look is not None:
        look_again(drone, detector, mode, found)
    drone.autopilot.hover(drone.action_s)


def act(drone: Drone, waypoint: Waypoint, found: list[Detection]) -> None:
    """Notify the user of what was found at the waypoint, and hover there for the action."""
    drone.user.notify(found, at=waypoint)
    drone.autopilot.hover(drone.action_s)
