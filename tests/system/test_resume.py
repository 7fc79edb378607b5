"""`upwash fly` is killed and started again with --resume, while a stand-in vehicle flies on by itself."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.waiting import wait_for

from upwash.launch.processes import ready_program

pytestmark = pytest.mark.system

CONFIG = """
name = "heron"
[mission]
program = "counting.py:patrol"
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
ground_speed_m_s = 15.0
altitude_m = 3.0
waypoints_m = [[0, 0], [20, 0], [40, 0], [40, 20]]
[autopilot]
connection = "udpout:127.0.0.1:1"
[camera]
folder = "photos"
photo_s = 0.2
[[service]]
name = "counter"
program = "counting.py:Counter"
local_call_s = 0.5
local_pace_s = 0.5
"""

COUNTING = """
from upwash import service

@service
class Counter:
    def count(self, photo: bytes) -> int:
        return len(photo)

def patrol(drone):
    counter = drone.service(Counter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.user.notify(counter.count(drone.camera.take_photo()), at=waypoint)
    drone.end_flight()
    drone.autopilot.disarm()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    (tmp_path / "drone.toml").write_text(CONFIG)
    (tmp_path / "counting.py").write_text(COUNTING)
    return tmp_path


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[str]:
    """The connection to a stand-in."""
    options = [
        "--listen",
        "udp:127.0.0.1:0",
        "--armable-after",
        "0",
        "--acceleration",
        "50",
        "--speedup",
        "3",
    ]
    with ready_program("vehicle", tmp_path, "vehicle", *options) as address:
        yield address.replace("udp:", "udpout:")


@contextlib.contextmanager
def flying(folder: Path, vehicle: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [
        sys.executable,
        "-m",
        "upwash",
        "fly",
        "--config",
        "drone.toml",
        "--autopilot",
        vehicle,
        *options,
    ]
    environment = {**os.environ, "COLUMNS": "200"}
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def events(log: Path) -> list[dict[str, Any]]:
    """Every line of the log, each of which must be whole."""
    return [msgspec.json.decode(line) for line in log.read_bytes().splitlines()]


def wait_for_events(log: Path, name: str, number: int) -> None:
    """Returns when the log has that many events of the name."""
    wait_for(
        lambda: log.exists() and sum(event["event"] == name for event in events(log)) >= number,
        within_s=60.0,
        seen=lambda: f"no {name} in the log",
    )


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("call", 2),
        *(pytest.param(*when, marks=pytest.mark.long) for when in [("armed", 1), ("took_off", 1)]),
        *(pytest.param(*when, marks=pytest.mark.long) for when in [("arrived", 2), ("leg", 4)]),
    ],
)
def test_a_flight_that_is_killed_is_taken_up_where_it_broke_off(
    folder: Path, vehicle: str, name: str, number: int
) -> None:
    log = folder / "events.jsonl"
    with flying(folder, vehicle, "--log", str(log)) as first:
        wait_for_events(log, name, number)
        first.kill()
    broken_off = events(log)
    with flying(folder, vehicle, "--resume", str(log)) as second:
        printed, _ = second.communicate(timeout=120)
    assert second.returncode == 0, printed
    both = events(log)
    assert both[: len(broken_off)] == broken_off
    assert both[len(broken_off)]["event"] == "log_resumed"
    assert [event["t"] for event in both] == sorted(event["t"] for event in both)
    assert answered_at(both) == [0, 1, 2, 3]
    assert "4 of 4 waypoints reached" in printed and "4 calls: 4 on the drone" in printed
    assert both[-1]["event"] == "mission_completed"


def answered_at(log: list[dict[str, Any]]) -> list[int]:
    """The waypoints at which calls were answered."""
    here, answered = -1, []
    for event in log:
        if event["event"] == "arrived":
            here = event["waypoint"]
        elif event["event"] == "call":
            answered.append(here)
    return answered


def test_a_flight_that_goes_on_is_not_taken_up_by_another_program(folder: Path, vehicle: str) -> None:
    log = folder / "events.jsonl"
    with flying(folder, vehicle, "--log", str(log)):
        wait_for_events(log, "arrived", 1)
        with flying(folder, vehicle, "--resume", str(log)) as second:
            printed, _ = second.communicate(timeout=60)
    assert second.returncode == 2
    assert "is the flight still under way?" in printed


def test_a_log_that_is_not_there_cannot_be_resumed(folder: Path) -> None:
    with flying(folder, "udpout:127.0.0.1:1", "--resume", "nothing.jsonl") as process:
        printed, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "cannot read the event log nothing.jsonl: No such file" in printed
