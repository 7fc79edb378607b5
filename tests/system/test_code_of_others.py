"""Flights whose program is held up, robbed of its files, or told to end by any signal, with a stand-in vehicle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.events import read
from tests.programs import UPWASH, running, stand_in, write_drone
from tests.waiting import wait_for

pytestmark = [pytest.mark.system, pytest.mark.flight]

HELD_UP = """
import re

def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    re.match(r"(a+)+$", "a" * 60 + "b")
"""
IMPATIENT = """
import sys
import upwash.launch.watchdog as watchdog
from upwash.cli.main import main

watchdog.SILENT_S = 2.5
sys.exit(main(sys.argv[1:]))
"""
WAITING = """
import threading

def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    threading.Event().wait()
"""


def test_a_flight_whose_mission_holds_pythons_lock_is_ended_by_another_program(tmp_path: Path) -> None:
    write_drone(tmp_path, HELD_UP, mission={"altitude_m": 5.0}, autopilot={"on_failure": "land"})
    log = tmp_path / "events.jsonl"
    with stand_in(tmp_path, "--acceleration", "4") as vehicle:
        fly = ("fly", "--config", "drone.toml", "--autopilot", vehicle, "--log", str(log), "--quiet")
        done = subprocess.run(
            [sys.executable, "-c", IMPATIENT, *fly],
            cwd=tmp_path,
            env=os.environ,
            capture_output=True,
            text=True,
            timeout=60.0,
            check=False,
        )
    assert done.returncode == -signal.SIGKILL
    assert "stood still for 2.5 s: it was killed, and another ends the flight" in done.stderr
    (ended,) = read(log, "safe_end")
    assert ended["action"] == "land" and "stood still" in ended["why"]
    assert read(log, "log_resumed") and read(log, "landed") and read(log, "mission_ended")


def test_a_signal_that_would_kill_ends_a_flight_safely(tmp_path: Path) -> None:
    write_drone(tmp_path, WAITING, mission={"altitude_m": 5.0}, autopilot={"on_failure": "land"})
    log = tmp_path / "events.jsonl"
    fly = ("fly", "--config", "drone.toml", "--log", log, "--autopilot")
    with (
        stand_in(tmp_path, "--acceleration", "4") as vehicle,
        running(*fly, vehicle, folder=tmp_path) as flight,
    ):
        wait_for(lambda: read(log, "took_off"), within_s=60.0)
        for _ in range(2):
            flight.send_signal(signal.SIGALRM)
        assert flight.stdout is not None
        flight.stdout.read()
        assert flight.wait(60.0) == 130
    assert [event["action"] for event in read(log, "safe_end")] == ["land"]
    assert [event["why"] for event in read(log, "stopping")] == ["SIGALRM"]


LEAKING = """
import os

KEPT = []

def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    try:
        while True:
            KEPT.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        pass
    drone.autopilot.hover(6.0)  # past two checks of the server
    for file in KEPT:
        os.close(file)
    drone.autopilot.hover(4.0)
    drone.autopilot.land()
"""


def test_a_mission_that_leaks_files_flies_on_without_servers(tmp_path: Path) -> None:
    server = {"name": "s1", "east_m": 0.0, "north_m": 0.0, "range_m": 500.0, "address": "127.0.0.1:1"}
    times = {"check_s": 0.5, "check_running_s": 0.3, "remote_call_s": {"light": 0.1, "heavy": 0.1}}
    write_drone(
        tmp_path,
        LEAKING,
        mission={"altitude_m": 5.0},
        policy={"name": "location-aware", "blacklist_s": 1.0},
        service=[{"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}],
        server=[server | times],
    )
    log = tmp_path / "events.jsonl"
    with stand_in(tmp_path, "--acceleration", "4") as vehicle:
        fly = [*UPWASH, "fly", "--config", "drone.toml", "--log", str(log), "--autopilot", vehicle]
        done = subprocess.run(
            ["sh", "-c", 'ulimit -n 256; exec "$@"', "sh", *fly],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120.0,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    scarce, ample = read(log, "supply_changed")
    assert (scarce["supply"], scarce["scarce"], ample["scarce"]) == ("files", True, False)
    refused = [event for event in read(log) if "left to open" in event.get("why", "")]
    assert refused and all(scarce["t"] <= event["t"] <= ample["t"] for event in refused)
    assert "the drone's computer has 0 files left to open: no server is dialled" in done.stdout
