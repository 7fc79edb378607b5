"""`upwash fly` with a vehicle that does not do its part: one clear message each."""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import os
import pty
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.events import read
from tests.programs import running, stand_in, write_drone

from upwash.cli.main import main
from upwash.errors import AutopilotError
from upwash.real.mavlink import DriverPatience, FlightSettings

pytestmark = pytest.mark.system

PLAN = {"ground_speed_m_s": 5.0, "altitude_m": 5.0, "waypoints_m": [[0, 0], [200, 0]]}
DETECTOR = {"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}
MISSION = """
import os, signal, threading
from pathlib import Path

def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    here, there = drone.plan
    drone.autopilot.goto(here)
    vehicle = int(Path("vehicle.pid").read_text())
    os.kill(vehicle, signal.SIGSTOP)  # silent, with the connection open, until it can land
    threading.Timer(4.0, os.kill, (vehicle, signal.SIGCONT)).start()
    drone.autopilot.goto(there)
"""

IMPATIENT = FlightSettings(
    ready_timeout_s=0.3,
    arm_again_s=0.1,
    patience=DriverPatience(others_s=0.0, quiet_after_s=0.5, lost_after_s=1.0),
)


vehicle = functools.partial(stand_in, Path(), listen="tcp:127.0.0.1:0")
Fly = Callable[[str], tuple[int, str]]


def configured(program: str, **tables: Any) -> None:
    """A drone in this folder, with a mission."""
    write_drone(Path(), program, **{"mission": PLAN, "service": [DETECTOR]} | tables)


@pytest.fixture
def fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Fly:
    """Flies the mission with an impatient driver; returns the exit code and the complaint."""
    monkeypatch.setattr("upwash.launch.flight.FlightSettings", lambda **_: IMPATIENT)
    monkeypatch.chdir(tmp_path)
    configured(MISSION)

    def flown(connection: str) -> tuple[int, str]:
        code = main(["fly", "--config", "drone.toml", "--autopilot", connection])
        return code, capsys.readouterr().err

    return flown


def test_a_vehicle_that_refuses_to_arm_is_quoted(fly: Fly) -> None:
    with vehicle("--fault", "arming") as connection:
        code, said = fly(connection)
    assert code == 1
    assert said.startswith("upwash: arm: the vehicle was not ready within 0.3 s")
    assert said.endswith('the vehicle last said: "Hardware safety switch"\n')
    assert said.count("\n") == 1


def test_a_vehicle_that_falls_silent_half_way_is_named_with_the_step(fly: Fly) -> None:
    with vehicle("--acceleration", "50") as connection:
        code, said = fly(connection)
    assert code == 1
    assert said.startswith("upwash: goto 200.0 m east, 0.0 m north: nothing was heard on tcp:")
    assert said.count("\n") == 1
    (log,) = Path("runs").glob("*/events.jsonl")
    told = [event for event in read(log) if event["event"].startswith("link_")]
    assert [event["event"] for event in told] == ["link_lost", "link_restored"]
    assert told[0]["silent_s"] < 1.0
    assert 3.0 < told[1]["silent_s"] < 8.0


BRIEF = """
def look(drone):
    print("said by the mission")
    drone.autopilot.arm()
    drone.autopilot.disarm()

def stumble(drone):
    drone.autopilot.arm()
    raise ValueError("no idea")
"""


def flown(mission: str, *options: str) -> int:
    with vehicle() as connection:
        return main(["fly", mission, "--config", "drone.toml", "--autopilot", connection, *options])


@contextlib.contextmanager
def on_a_terminal(connection: str, *options: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A flight that has a terminal, and the other end of that."""
    terminal, ours = pty.openpty()
    command = ("fly", *options, "--config", "drone.toml", "--autopilot", connection)
    with running(*command, stdin=ours, stdout=ours, stderr=ours) as flight:
        os.close(ours)
        yield flight, terminal


@pytest.fixture
def brief(fly: Fly) -> None:
    """Missions that never leave the ground."""
    Path("brief.py").write_text(BRIEF)


@pytest.mark.usefixtures("brief")
def test_without_a_terminal_a_flight_is_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert flown("brief.py:look") == 0
    printed = capsys.readouterr().out
    assert re.search(r"^ *\[\d+:\d\d\] +mission started$", printed, flags=re.MULTILINE), printed
    assert "\x1b" not in printed


@pytest.mark.usefixtures("brief")
def test_on_a_terminal_what_a_mission_prints_stands_once_among_the_lines() -> None:
    with (
        vehicle("--armable-after", "3") as connection,
        on_a_terminal(connection, "brief.py:look") as (flight, terminal),
    ):
        shown = b"".join(_read_all(terminal))
        assert flight.wait(60.0) == 0
    os.close(terminal)
    assert shown.count(b"said by the mission") == 1
    places = [shown.index(words) for words in (b"mission started", b"said by the mission", b" arming")]
    assert places == sorted(places)


def _read_all(terminal: int) -> Iterator[bytes]:
    """Until nobody writes there any more, which is an error on Linux."""
    with contextlib.suppress(OSError):
        while part := os.read(terminal, 65536):
            yield part


@pytest.mark.usefixtures("brief")
def test_a_quiet_flight_prints_what_its_mission_does_and_nothing_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert flown("brief.py:look", "--quiet") == 0
    assert capsys.readouterr() == ("said by the mission\n", "")


@pytest.mark.usefixtures("brief")
def test_a_flights_result_is_one_object_as_report_has_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert flown("brief.py:look", "--json", "--log", "flight.jsonl") == 0
    printed, said = capsys.readouterr()
    assert printed.count("\n") == 1
    assert said == "said by the mission\n"
    assert main(["report", "flight.jsonl", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [json.loads(printed)]


@pytest.mark.usefixtures("brief")
def test_a_flight_that_fails_leaves_its_object_and_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert flown("brief.py:stumble", "--json") == 1
    printed, said = capsys.readouterr()
    assert json.loads(printed)["result"]["completed"] is False
    assert said.endswith("upwash: the mission program raised ValueError: no idea\n")
    assert 'brief.py", line 9, in stumble' in said
    assert "upwash/" not in said


TELLING = """
def fly(drone):
    drone.autopilot.arm()
    for what in ("fire", "smoke"):
        drone.user.notify(what, at=drone.plan[0])
    drone.autopilot.disarm()
"""


@pytest.mark.usefixtures("fly")
def test_findings_are_handed_over_and_the_log_says_what_was_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("upwash.launch.handover._LAST_S", 2.0)
    Path("told.sh").write_text('#!/bin/sh\ncat >> "${0%/*}/told.jsonl"\n')
    Path("told.sh").chmod(0o755)
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as closed:
        port = closed.getsockname()[1]
    hook = f"http://127.0.0.1:{port}/secret"
    configured(TELLING, user={"command": ["./told.sh"], "webhook": hook})
    with vehicle() as connection:
        fly = ["fly", "--config", "drone.toml", "--autopilot", connection, "--log", "log"]
        assert main(fly) == 0
    told = [json.loads(line) for line in Path("told.jsonl").read_text().splitlines()]
    assert [(found["label"], found["drone"]) for found in told] == [("fire", "heron"), ("smoke", "heron")]
    trouble, failed = read("log", "handover_trouble", "handover_failed")
    assert trouble["why"] == "it is not reached: Connection refused"
    assert (failed["to"], failed["count"]) == ("the webhook at 127.0.0.1", 2)
    assert "not handed over to the webhook at 127.0.0.1: 2 findings" in capsys.readouterr().out
    assert "secret" not in Path("log").read_text()


SHORT = """
def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    drone.autopilot.return_home_and_land()
    print("said to nobody")
"""


@pytest.mark.flight
@pytest.mark.usefixtures("fly")
def test_a_flight_goes_on_when_its_terminal_is_closed() -> None:
    configured(SHORT)
    with (
        vehicle("--acceleration", "50") as connection,
        on_a_terminal(connection, "--log", "log") as (flight, terminal),
    ):
        while b"returning home" not in os.read(terminal, 4096):
            pass
        os.close(terminal)
        flight.send_signal(signal.SIGHUP)
        assert flight.wait(60.0) == 0
    assert "mission_completed" in Path("log").read_text()


@pytest.mark.usefixtures("brief")
def test_a_flight_with_signed_messages_needs_the_vehicles_key(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("signing.key", "another.key"):
        assert main(["keys", "--signing", name]) == 0
    fly = ["fly", "brief.py:look", "--config", "drone.toml", "--quiet", "--autopilot"]
    with vehicle("--signing-key", "signing.key") as connection:
        for code, key in enumerate(("signing.key", "another.key")):
            configured("", autopilot={"signing_key": key})
            assert main([*fly, connection]) == code
    assert "its messages are signed with another key" in capsys.readouterr().err


@pytest.mark.usefixtures("brief")
def test_a_port_that_anyone_reaches_is_warned_of_at_the_start(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nobody(*_: object, **__: object) -> None:
        raise AutopilotError("connect", "nobody is there")

    monkeypatch.setattr("upwash.launch.drone.connect_autopilot", nobody)
    fly = ["fly", "brief.py:look", "--config", "drone.toml", "--log", "flight.jsonl"]
    assert main([*fly, "--autopilot", "udpin:0.0.0.0:14550"]) == 1
    assert "udpin:0.0.0.0:14550 listens to networks, and messages are not signed" in capsys.readouterr().out
    assert "unsigned_port" in Path("flight.jsonl").read_text()


@pytest.mark.usefixtures("fly")
def test_after_the_second_ctrl_c_it_says_that_the_vehicle_is_left_to_itself() -> None:
    configured(FAR)
    with vehicle("--acceleration", "5", speedup=1) as connection:  # it is not down before the second
        command = ("fly", "--config", "drone.toml", "--autopilot", connection, "--log", "log")
        with running(*command, stderr=subprocess.PIPE) as flight:
            assert flight.stdout is not None
            assert flight.stderr is not None
            stopped = [line for line in iter(flight.stdout.readline, "") if _stop_at(flight, line)]
            said = flight.stderr.read()
            assert flight.wait(20.0) == 130
    assert stopped
    assert said.endswith(
        "a vehicle in the air goes on with what it was last told, take over with the remote control\n"
    )


FAR = """
def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(2.0)
    print("in the air", flush=True)
    drone.autopilot.goto(drone.plan[1])
"""


def _stop_at(flight: subprocess.Popen[str], line: str) -> bool:
    """Stops the flight politely once it is in the air, and at once when it is on its way home."""
    stops = "in the air" in line or "returning to land" in line
    if stops:
        time.sleep(0.6)  # within less, a second Ctrl-C is taken for the first one's echo
        flight.send_signal(signal.SIGINT)
    return stops


WATCHED = """
import http.client, logging
from pathlib import Path

def fly(drone):
    drone.autopilot.arm()
    (handler,) = logging.getLogger("upwash.metrics").handlers
    connection = http.client.HTTPConnection(handler.address, timeout=10.0)
    connection.request("GET", "/metrics")
    Path("metrics.txt").write_bytes(connection.getresponse().read())
    drone.autopilot.disarm()
"""


class AddressHandler(logging.Handler):
    """Remembers where metrics are."""

    address = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.address = re.findall(r"http://(.*)/metrics", record.getMessage())[0]


@pytest.mark.usefixtures("fly")
def test_prometheus_finds_a_flights_numbers_while_it_flies(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    configured(WATCHED, metrics="127.0.0.1:0")
    monkeypatch.setattr(logging.getLogger("upwash.metrics"), "handlers", [AddressHandler()])
    caplog.set_level(logging.INFO, "upwash.metrics")
    assert flown("mission.py:fly", "--quiet") == 0
    told = Path("metrics.txt").read_text().splitlines()
    assert "upwash_mission_under_way 1.0" in told
    assert "upwash_waypoints 2.0" in told


PATIENT = """
import time

def fly(drone):
    drone.autopilot.arm()
    time.sleep(1.0)
    drone.autopilot.disarm()
"""

WITHOUT_RANGE = {"name": "s1", "range_m": "measured", "address": "127.0.0.1:1", "remote_call_s": 0.2}


@pytest.mark.parametrize("ends", ["well", "badly"])
@pytest.mark.usefixtures("fly")
def test_what_a_flight_measured_of_a_server_without_a_range_is_kept_however_it_ends(ends: str) -> None:
    program = PATIENT + ("" if ends == "well" else "    raise ValueError('no idea')\n")
    configured(program, network={"coverage_map": "lte.coverage.json"}, server=[WITHOUT_RANGE])
    assert flown("mission.py:fly") == (0 if ends == "well" else 1)
    kept = json.loads(Path("lte.coverage.json").read_text())
    (place,) = kept["servers"]["s1"]
    assert place["tried"] > 0
    assert place["answered"] == 0
    assert kept["home"] == {"latitude_deg": 39.3666, "longitude_deg": 22.9507}
