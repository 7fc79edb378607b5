"""Flies a square on a PX4 with pymavlink alone: python bare_px4.py CONNECTION. Prints the corners reached."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

HOME_DEG = 39.3666, 22.9507
ALTITUDE_M = 15.0
EAST_DEG, NORTH_DEG = 20 / 86_170, 20 / 111_030  # 20 m there
CORNERS_DEG = [
    (HOME_DEG[0] + north * NORTH_DEG, HOME_DEG[1] + east * EAST_DEG)
    for east, north in ((1, 0), (1, 1), (0, 1), (0, 0))
]
PATIENCE_S = 60.0
AUTO, LOITER, RTL = 4, 3, 5


def until(vehicle: Any, condition: Any) -> Any:
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        message = vehicle.recv_match(blocking=True, timeout=1.0)
        if message is not None and condition(message):
            return message
    raise SystemExit("nothing of the kind came")


def command(vehicle: Any, number: int, *parameters: float) -> int:
    for _ in range(5):  # a PX4 says so much by itself that an answer may get lost
        vehicle.mav.command_long_send(1, 1, number, 0, *parameters, *[0] * (7 - len(parameters)))
        deadline_s = time.monotonic() + 3.0
        while time.monotonic() < deadline_s:
            message = vehicle.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0)
            if message is not None and message.command == number:
                return int(message.result)
    raise SystemExit(f"command {number} was not answered")


def in_mode(message: Any, sub: int) -> bool:
    beats = message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1
    return bool(beats and message.custom_mode == AUTO << 16 | sub << 24)


def near(message: Any, corner_deg: tuple[float, float]) -> bool:
    if message.get_type() != "GLOBAL_POSITION_INT":
        return False
    north_m = (message.lat / 1e7 - corner_deg[0]) / NORTH_DEG * 20
    east_m = (message.lon / 1e7 - corner_deg[1]) / EAST_DEG * 20
    return math.hypot(north_m, east_m) < 1 and math.hypot(message.vx, message.vy) < 50


def fly(connection: str) -> None:
    vehicle = mavutil.mavlink_connection(connection, source_system=255)
    vehicle.mav.heartbeat_send(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    vehicle.wait_heartbeat()
    for unneeded in (30, 31, 32, 74, 85, 87):
        command(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, unneeded, -1)
    while command(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) != 0:
        time.sleep(0.1)
    home = until(vehicle, lambda message: message.get_type() == "HOME_POSITION")
    above_sea_m = home.altitude / 1e3 + ALTITUDE_M
    nan = math.nan
    if command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, nan, 0, 0, nan, nan, nan, above_sea_m) != 0:
        raise SystemExit("the take-off was refused")
    until(vehicle, lambda message: in_mode(message, 2))
    until(vehicle, lambda message: in_mode(message, LOITER))
    for latitude_deg, longitude_deg in CORNERS_DEG:
        vehicle.mav.command_int_send(
            1, 1, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, 4.0, 1, 0, nan,
            round(latitude_deg * 1e7), round(longitude_deg * 1e7), above_sea_m,
        )  # fmt: skip
        until(vehicle, lambda message, corner=(latitude_deg, longitude_deg): near(message, corner))
        print("corner", flush=True)
    command(vehicle, mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO, RTL)
    until(
        vehicle,
        lambda message: (
            message.get_type() == "HEARTBEAT"
            and message.get_srcComponent() == 1
            and not message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        ),
    )
    print("disarmed", flush=True)
    vehicle.close()


if __name__ == "__main__":
    fly(sys.argv[1])
