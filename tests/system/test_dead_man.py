"""`upwash check` installs the dead man in a stand-in vehicle, and it brings back a flight whose program is killed."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import pytest
from pymavlink import mavutil
from tests.events import read
from tests.programs import running, stand_in, upwash, write_drone
from tests.waiting import wait_for

pytestmark = pytest.mark.system

WAITING = """
import threading

def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    threading.Event().wait()
"""
RTL = 6


def test_a_flight_whose_program_is_killed_is_brought_home(tmp_path: Path) -> None:
    write_drone(tmp_path, WAITING, mission={"altitude_m": 10.0}, autopilot={"dead_man_s": 10.0})
    log = tmp_path / "events.jsonl"
    with stand_in(tmp_path) as vehicle:
        check = ("check", "drone.toml", "--autopilot", vehicle)
        fly = ("fly", "--config", "drone.toml", "--autopilot", vehicle)
        done = upwash(*check, "--vehicle", folder=tmp_path)
        assert done.returncode == 1
        assert "install it with: upwash check CONFIG --install-dead-man" in done.stdout + done.stderr
        done = upwash(*fly, folder=tmp_path)
        assert done.returncode != 0
        assert "dead man: the dead man is not in the autopilot" in done.stdout + done.stderr
        done = upwash(*check, "--install-dead-man", folder=tmp_path)
        assert done.returncode == 0 and "dead man: ready in the autopilot" in done.stdout + done.stderr

        with running(*fly, "--log", log, folder=tmp_path):
            wait_for(lambda: read(log, "took_off"), within_s=60.0)
        assert read(log, "dead_man_set")
        with contextlib.closing(mavutil.mavlink_connection(vehicle, source_system=255)) as observer:
            until_s = time.monotonic() + 30
            mode = None
            while mode != RTL:
                assert time.monotonic() < until_s
                observer.mav.heartbeat_send(6, 8, 0, 0, 0)
                heartbeat = observer.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
                mode = heartbeat and heartbeat.custom_mode
