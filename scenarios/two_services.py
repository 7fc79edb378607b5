"""The mission of two-services.toml, with its second service."""

from upwash import Drone, service
from upwash.services import Detector, Mode


@service(name="dirt")
class DirtGauge:
    """Says how dirty panels are."""

    def measure(self, photo: bytes) -> float:
        """The share of the light that the dirt on them takes away, from 0 to 1."""
        return photo.count(0) / max(1, len(photo))


def inspect_and_measure(drone: Drone, mode: Mode = "heavy") -> None:
    """Has every photo looked at twice before moving on."""
    detector, gauge = drone.service(Detector), drone.service(DirtGauge)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = drone.camera.take_photo()
        for found in (detector.process_photo(photo, mode=mode), gauge.measure(photo)):
            if found:
                drone.user.notify(found, at=waypoint)
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
