"""Flights whose program is held up, robbed of its files, or told to end by any signal, with a stand-in vehicle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.events import read
from tests.programs import running, stand_in, write_drone
from tests.waiting import wait_for

pytestmark = pytest.mark.system

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
    with stand_in(tmp_path, "--speedup", "4", "--acceleration", "4") as vehicle:
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


@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGUSR1, signal.SIGALRM, signal.SIGRTMIN + 3])
def test_any_signal_that_would_kill_ends_a_flight_safely(tmp_path: Path, number: int) -> None:
    write_drone(tmp_path, WAITING, mission={"altitude_m": 5.0}, autopilot={"on_failure": "land"})
    log = tmp_path / "events.jsonl"
    with (
        stand_in(tmp_path, "--speedup", "4", "--acceleration", "4") as vehicle,
        running(
            "fly", "--config", "drone.toml", "--autopilot", vehicle, "--log", log, folder=tmp_path
        ) as flight,
    ):
        wait_for(lambda: read(log, "took_off"), within_s=30.0)
        for _ in range(2):
            flight.send_signal(number)
        assert flight.stdout is not None
        flight.stdout.read()
        assert flight.wait(30.0) == 130
    assert [event["action"] for event in read(log, "safe_end")] == ["land"]
    assert read(log, "landed")
