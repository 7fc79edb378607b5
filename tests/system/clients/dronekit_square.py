"""Flies a square with DroneKit, at the connection of its argument; prints the corners."""

from __future__ import annotations

import collections
import collections.abc
import math
import sys
import time
from collections.abc import Callable
from typing import Any

collections.MutableMapping = collections.abc.MutableMapping  # type: ignore[attr-defined]  # DroneKit is of 2019

from dronekit import LocationGlobalRelative, VehicleMode, connect  # noqa: E402

ALTITUDE_M = 15.0
CORNERS_M = (20, 0), (20, 20), (0, 20), (0, 0)
PATIENCE_S = 30.0


def until(condition: Callable[[], Any]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise SystemExit("it did not come true")
        time.sleep(0.02)


def fly(connection: str) -> None:
    vehicle = connect(connection, wait_ready=True, rate=10, heartbeat_timeout=20)
    until(lambda: vehicle.is_armable)
    vehicle.mode = VehicleMode("GUIDED")
    until(lambda: vehicle.mode.name == "GUIDED")
    vehicle.armed = True
    until(lambda: vehicle.armed)
    vehicle.simple_takeoff(ALTITUDE_M)
    until(lambda: vehicle.location.global_relative_frame.alt > ALTITUDE_M * 0.95)
    home = vehicle.location.global_relative_frame
    for east_m, north_m in CORNERS_M:
        latitude_deg, longitude_deg = home.lat + north_m / 111_030, home.lon + east_m / 86_170
        vehicle.simple_goto(LocationGlobalRelative(latitude_deg, longitude_deg, ALTITUDE_M), groundspeed=4)

        def near(latitude_deg: float = latitude_deg, longitude_deg: float = longitude_deg) -> bool:
            here = vehicle.location.global_relative_frame
            north_m = (here.lat - latitude_deg) * 111_030
            east_m = (here.lon - longitude_deg) * 86_170
            return math.hypot(north_m, east_m) < 1 and float(vehicle.groundspeed) < 0.5

        until(near)
        print("corner", flush=True)
    vehicle.mode = VehicleMode("RTL")
    until(lambda: not vehicle.armed)
    print("disarmed", flush=True)
    vehicle.close()


if __name__ == "__main__":
    fly(sys.argv[1])
