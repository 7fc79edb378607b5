"""A mission that acts on the objects which its world has drawn on the ground, and the service that finds them."""

from __future__ import annotations

from functools import partial

import msgspec

from upwash.core.geo import Waypoint
from upwash.drone.api import Drone
from upwash.drone.objects import FoundObject
from upwash.lab.faults.mission import Mode, visits
from upwash.rpc.service import service
from upwash.sim.drawn import ShownObject, shown_in

_ACTS_S = 1.0


class AnswerTold(msgspec.Struct, frozen=True, kw_only=True):
    """The mission has the answer of the waypoint with that index."""

    told: int


class ObjectReport(msgspec.Struct, frozen=True, kw_only=True):
    """The mission acts on an object with that label, where the drone is."""

    acted: str


@service(profile_by="mode")
class Spotter:
    """Finds the objects in photos."""

    def look(self, photo: bytes, mode: Mode) -> list[ShownObject]:
        """All of them, slowly or fast."""
        del mode
        return shown_in(photo) or []


def look_for_objects(drone: Drone, mode: Mode) -> None:
    """Has a photo looked at, at each waypoint, and acts on each object once."""
    spotter = drone.service(Spotter)
    for _, waypoint in visits(drone):
        pending = drone.start(spotter.look, drone.camera.take_photo(), mode)
        drone.act_once(pending, partial(_act, drone), tell=partial(_tell, drone, waypoint))


def _tell(drone: Drone, waypoint: Waypoint, found: list[ShownObject]) -> None:
    drone.user.notify(AnswerTold(told=waypoint.index), at=waypoint)
    if found:
        drone.user.notify(found, at=waypoint)


def _act(drone: Drone, found: FoundObject) -> None:
    drone.user.notify(ObjectReport(acted=found.label), at=drone.autopilot.position)
    drone.autopilot.hover(_ACTS_S)
