"""The square that clients fly, and what pymavlink alone hears of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

HOME_DEG = 39.3666, 22.9507
ALTITUDE_M = 15.0
CORNERS_M = (20, 0), (20, 20), (0, 20), (0, 0)
NORTH_M, EAST_M = 111_030, 86_170  # of a degree there
CORNERS_DEG = [(HOME_DEG[0] + north / NORTH_M, HOME_DEG[1] + east / EAST_M) for east, north in CORNERS_M]
PATIENCE_S = 60.0


def connected(connection: str) -> Any:
    """The vehicle, once it has been heard."""
    vehicle = mavutil.mavlink_connection(connection, source_system=255)
    vehicle.mav.heartbeat_send(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    vehicle.wait_heartbeat()
    return vehicle


def until(vehicle: Any, condition: Callable[[Any], object]) -> Any:
    """The first message of which that is true; ends the program where there is none."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        message = vehicle.recv_match(blocking=True, timeout=1.0)
        if message is not None and condition(message):
            return message
    raise SystemExit("nothing of the kind came")


def near(corner_deg: tuple[float, float], message: Any) -> bool:
    """Whether the vehicle stands there."""
    if message.get_type() != "GLOBAL_POSITION_INT":
        return False
    north_m = (message.lat / 1e7 - corner_deg[0]) * NORTH_M
    east_m = (message.lon / 1e7 - corner_deg[1]) * EAST_M
    return math.hypot(north_m, east_m) < 1 and math.hypot(message.vx, message.vy) < 50


def wait_for_the_end(vehicle: Any) -> None:
    """Returns when the vehicle is disarmed."""

    def disarmed(message: Any) -> bool:
        beats = message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1
        return beats and not message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED

    until(vehicle, disarmed)
    print("disarmed", flush=True)
    vehicle.close()
