"""Flies a square with pymavlink alone, at the connection of its argument; prints the corners."""

from __future__ import annotations

import functools
import sys
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.clients.square import ALTITUDE_M, CORNERS_DEG, connected, near, until, wait_for_the_end


def command(vehicle: Any, number: int, *parameters: float) -> None:
    vehicle.mav.command_long_send(1, 1, number, 0, *parameters, *[0] * (7 - len(parameters)))
    ack = until(vehicle, lambda message: message.get_type() == "COMMAND_ACK" and message.command == number)
    if ack.result != 0:
        raise SystemExit(f"command {number} was answered {ack.result}")


def fly(connection: str) -> None:
    vehicle = connected(connection)
    for report, every_us in (("EKF_STATUS_REPORT", 200_000), ("GLOBAL_POSITION_INT", 100_000)):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{report}")
        command(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, every_us)
    until(vehicle, lambda message: message.get_type() == "EKF_STATUS_REPORT" and message.flags == 831)
    command(vehicle, mavlink.MAV_CMD_DO_SET_MODE, 1, mavlink.COPTER_MODE_GUIDED)
    command(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, ALTITUDE_M)
    high_mm = ALTITUDE_M * 950
    until(vehicle, lambda said: said.get_type() == "GLOBAL_POSITION_INT" and said.relative_alt > high_mm)
    for corner in CORNERS_DEG:
        latitude, longitude = (round(each * 1e7) for each in corner)
        vehicle.mav.set_position_target_global_int_send(
            0, 1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000, latitude, longitude, ALTITUDE_M,
            0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip
        until(vehicle, functools.partial(near, corner))
        print("corner", flush=True)
    command(vehicle, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    wait_for_the_end(vehicle)


if __name__ == "__main__":
    fly(sys.argv[1])
