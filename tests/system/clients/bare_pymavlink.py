"""Flies a square with pymavlink alone: python bare_pymavlink.py CONNECTION. Prints the corners as it reached them."""

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
PATIENCE_S = 30.0


def command(vehicle: Any, number: int, *parameters: float) -> None:
    vehicle.mav.command_long_send(1, 1, number, 0, *parameters, *[0] * (7 - len(parameters)))
    until(vehicle, lambda message: message.get_type() == "COMMAND_ACK" and message.command == number)
    ack = vehicle.messages["COMMAND_ACK"]
    if ack.result != 0:
        raise SystemExit(f"command {number} was answered {ack.result}")


def until(vehicle: Any, condition: Any) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        message = vehicle.recv_match(blocking=True, timeout=1.0)
        if message is not None and condition(message):
            return
    raise SystemExit("nothing of the kind came")


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
    command(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 200_000)
    until(vehicle, lambda message: message.get_type() == "EKF_STATUS_REPORT" and message.flags == 831)
    command(
        vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 100_000
    )
    command(vehicle, mavlink.MAV_CMD_DO_SET_MODE, 1, mavlink.COPTER_MODE_GUIDED)
    command(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, ALTITUDE_M)
    until(
        vehicle,
        lambda message: (
            message.get_type() == "GLOBAL_POSITION_INT" and message.relative_alt > ALTITUDE_M * 950
        ),
    )
    for latitude_deg, longitude_deg in CORNERS_DEG:
        vehicle.mav.set_position_target_global_int_send(
            0, 1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000,
            round(latitude_deg * 1e7), round(longitude_deg * 1e7), ALTITUDE_M, 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip
        until(vehicle, lambda message, corner=(latitude_deg, longitude_deg): near(message, corner))
        print("corner", flush=True)
    command(vehicle, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
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
