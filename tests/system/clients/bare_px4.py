"""Flies a square on a PX4 with pymavlink alone, at the connection of its argument; prints the corners."""

from __future__ import annotations

import functools
import math
import sys
import time
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.system.clients.square import ALTITUDE_M, CORNERS_DEG, connected, near, until, wait_for_the_end

AUTO, TAKEOFF, LOITER, RTL = 4, 2, 3, 5


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


def fly(connection: str) -> None:
    vehicle = connected(connection)
    for unneeded in (30, 31, 32, 74, 85, 87):
        command(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, unneeded, -1)
    while command(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) != 0:
        time.sleep(0.1)
    home = until(vehicle, lambda message: message.get_type() == "HOME_POSITION")
    above_sea_m = home.altitude / 1e3 + ALTITUDE_M
    nan = math.nan
    if command(vehicle, mavlink.MAV_CMD_NAV_TAKEOFF, nan, 0, 0, nan, nan, nan, above_sea_m) != 0:
        raise SystemExit("the take-off was refused")
    until(vehicle, lambda message: in_mode(message, TAKEOFF))
    until(vehicle, lambda message: in_mode(message, LOITER))
    for corner in CORNERS_DEG:
        latitude, longitude = (round(each * 1e7) for each in corner)
        vehicle.mav.command_int_send(
            1, 1, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, 4.0, 1, 0, nan,
            latitude, longitude, above_sea_m,
        )  # fmt: skip
        until(vehicle, functools.partial(near, corner))
        print("corner", flush=True)
    command(vehicle, mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO, RTL)
    wait_for_the_end(vehicle)


if __name__ == "__main__":
    fly(sys.argv[1])
