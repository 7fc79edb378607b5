"""`upwash check` installs the dead man in a stand-in vehicle, and it brings back a flight whose program is killed."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink import mavutil
from tests.waiting import wait_for

from upwash.launch.processes import ready_program

pytestmark = pytest.mark.system

SPEEDUP = 4
CONFIG = """
name = "heron"
[mission]
program = "waiting.py:wait"
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
altitude_m = 10.0
waypoints_m = [[0, 0]]
[autopilot]
connection = "udpout:127.0.0.1:1"
dead_man_s = 10.0
[camera]
folder = "photos"
"""
WAITING = """
import threading

def wait(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    threading.Event().wait()
"""
RTL = 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    (tmp_path / "drone.toml").write_text(CONFIG)
    (tmp_path / "waiting.py").write_text(WAITING)
    return tmp_path


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[str]:
    options = ["--listen", "udp:127.0.0.1:0", "--armable-after", "0", "--speedup", str(SPEEDUP)]
    with ready_program("vehicle", tmp_path, "vehicle", *options) as address:
        yield address.replace("udp:", "udpout:")


def upwash(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "upwash", *arguments],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    with process:
        printed, _ = process.communicate(timeout=60)
    return process.returncode, printed


def test_a_flight_whose_program_is_killed_is_brought_home(folder: Path, vehicle: str) -> None:
    to_vehicle = ("--autopilot", vehicle)
    returned, printed = ended(upwash(folder, "check", "drone.toml", "--vehicle", *to_vehicle))
    assert returned == 1 and "install it with: upwash check CONFIG --install-dead-man" in printed
    returned, printed = ended(upwash(folder, "fly", "--config", "drone.toml", *to_vehicle))
    assert returned != 0 and "dead man: the dead man is not in the autopilot" in printed
    returned, printed = ended(upwash(folder, "check", "drone.toml", "--install-dead-man", *to_vehicle))
    assert returned == 0 and "dead man: ready in the autopilot" in printed

    log = folder / "events.jsonl"
    with upwash(folder, "fly", "--config", "drone.toml", "--log", str(log), *to_vehicle) as flight:
        wait_for(lambda: log.exists() and '"took_off"' in log.read_text(), within_s=60.0)
        flight.kill()
    assert '"dead_man_set"' in log.read_text()
    with contextlib.closing(mavutil.mavlink_connection(vehicle, source_system=255)) as observer:
        until_s = time.monotonic() + 30
        mode = None
        while mode != RTL:
            assert time.monotonic() < until_s
            observer.mav.heartbeat_send(6, 8, 0, 0, 0)
            heartbeat = observer.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
            mode = heartbeat and heartbeat.custom_mode
