"""The second look: a photo of an object from lower down, while the survey goes on."""

from __future__ import annotations

from functools import partial

from upwash import AutopilotRefused, Drone, FoundObject
from upwash.missions.photos import notify, notify_failure, photo_at
from upwash.services import Detector, Mode


def look_again(drone: Drone, detector: Detector, mode: Mode, found: FoundObject) -> None:
    """Go down over the object, have a photo of it inspected, and come up again; the answer is told once it is there.

    A look that a fence forbids is left out, with a message to the user.
    """
    assert drone.second_look is not None  # noqa: S101 - it is configured
    low = found.over(drone.second_look.altitude_m)
    try:
        drone.autopilot.goto(low)
    except AutopilotRefused as error:
        drone.user.notify(f"no second look at {found.label}: {error}", at=found.position)
        return
    photo = photo_at(drone, low)
    if photo is not None:
        pending = drone.start(detector.process_photo, photo, mode=mode)
        drone.when_answered(pending, partial(notify, drone, low), failed=partial(notify_failure, drone, low))
    drone.autopilot.goto(found.position)
