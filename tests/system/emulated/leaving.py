"""A mission whose drone leaves a server's range in the middle of a call there."""

from __future__ import annotations

import asyncio

from upwash import Drone
from upwash.core.geo import Position
from upwash.services import Detector


def leave_during_a_call(drone: Drone) -> None:
    detector = drone.service(Detector)
    pilot = drone.autopilot
    pilot.arm()
    pilot.takeoff(drone.altitude_m)
    pilot.goto(drone.plan[0])
    detector.process_photo(drone.camera.take_photo(), mode="light")
    photo = drone.camera.take_photo()
    # No mission can do two things at once: the flight goes on behind the verbs' back.
    away = pilot._autopilot.goto(Position(60.0, 0.0, drone.altitude_m))
    leg = asyncio.run_coroutine_threadsafe(away, pilot._thread._loop)
    detector.process_photo(photo, mode="heavy")
    leg.result()
    pilot.return_home_and_land()
