"""A mission with a service of its own: counts bright pixels at every waypoint of the plan."""

from dataclasses import dataclass

from upwash import Drone, service


@dataclass
class Count:
    """What the service finds in a photo."""

    bright_pixels: int


@service
class Counter:
    """Counts, on the drone or on a server."""

    def __init__(self) -> None:
        self.threshold = 200

    def count(self, photo: bytes) -> Count:
        """How many bytes of the photo lie above the threshold."""
        return Count(sum(byte > self.threshold for byte in photo))


def patrol(drone: Drone) -> None:
    """Visits every waypoint and tells the user what was counted there."""
    counter = drone.service(Counter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        count = counter.count(drone.camera.take_photo())
        drone.user.notify(count, at=waypoint)
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
