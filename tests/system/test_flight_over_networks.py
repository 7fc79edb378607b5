"""A flight whose networks the real NetworkManager joins: what the drone does, and what its event log says of it."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.system.radios import Field
from tests.waiting import wait_for

from upwash.real.trust.authority import make_keys

pytestmark = [pytest.mark.system, pytest.mark.root]

PATIENCE_S = 60.0  # on a busy machine
CALL_S = 2.0
DEADLINE_S = 4 * CALL_S  # of a remote call

MISSION = f"""
import time
from pathlib import Path
from services_for_tests import Workbench

def fly(drone):
    bench = drone.service(Workbench)
    while not Path("go").exists():
        time.sleep(0.05)
    bench.pause({CALL_S})
"""

DRONE = """
name = "heron"
[mission]
program = "mission.py:fly"
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
waypoints_m = [[0, 0]]
[autopilot]
connection = "AUTOPILOT"
[network]
kind = "networkmanager"
interfaces = ["radio1", "radio2"]
[keys]
authority = "keys/authority.pem"
certificate = "keys/heron.pem"
key = "keys/heron.key"
[camera]
folder = "photos"
[[service]]
name = "workbench"
program = "services_for_tests.py:Workbench"
local_call_s = { light = 20.0, heavy = 20.0, pause = 20.0 }
"""

SERVER = """
[[server]]
name = "NAME"
network = "NAME-net"
address = "10.91.1.1:7070"
east_m = 0.0
north_m = 0.0
range_m = 1000.0
remote_call_s = { light = CALL_S, heavy = CALL_S, pause = CALL_S }
"""

DAEMON = """
listen = "10.91.1.1:7070"
runtime = { sandbox_as_root = true }
[keys]
authority = "keys/authority.pem"
certificate = "keys/s1.pem"
key = "keys/s1.key"
[[service]]
name = "workbench"
program = "services_for_tests.py:Workbench"
[[server]]
name = "s1"
"""


@dataclass
class Flight:
    folder: Path
    process: subprocess.Popen[bytes]

    def events(self, name: str = "") -> list[dict[str, Any]]:
        log = self.folder / "events.jsonl"
        events = (
            [
                msgspec.json.decode(line)
                for line in log.read_bytes().splitlines(keepends=True)
                if line.endswith(b"\n")
            ]
            if log.exists()
            else []
        )
        return [event for event in events if name in ("", event["event"])]

    def wait_for(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        found = wait_for(
            lambda: [event for event in self.events() if wanted(event)],
            within_s=PATIENCE_S,
            process=self.process,
            seen=self.events,
        )
        return found[0]


@contextlib.contextmanager
def ready(command: list[str], folder: Path, name: str) -> Iterator[str]:
    """Runs an upwash command until the end of the block; yields its address."""
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout is not None
    try:
        said = process.stdout.readline()
        assert " ready at " in said, (folder / f"{name}.log").read_text()
        yield said.strip().partition(" ready at ")[2]
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


@pytest.fixture
def flight(field: Field, services: Path) -> Iterator[Flight]:
    """A drone among s3, which it has no profile for, s2, where nothing gives it an address, and s1, which is well."""
    folder = field.folder
    field.stop_dhcp(2)
    make_keys(folder / "keys", servers=[["s1"]], drones=["heron"])
    (folder / "photos").mkdir()
    (folder / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    (folder / "services_for_tests.py").write_text(services.read_text())
    (folder / "mission.py").write_text(MISSION)
    (folder / "daemon.toml").write_text(DAEMON)
    upwash = [sys.executable, "-m", "upwash"]
    vehicle = field.entered(*upwash, "vehicle", "--listen", "tcp:127.0.0.1:0", "--armable-after", "0")
    daemon = field.entered(*upwash, "serve", "--config", "daemon.toml", among="s1")
    with ready(daemon, folder, "daemon"), ready(vehicle, folder, "vehicle") as autopilot:
        servers = [("s3", 0.1), ("s2", 0.2), ("s1", CALL_S)]
        text = DRONE.replace("AUTOPILOT", autopilot)
        text += "".join(SERVER.replace("NAME", name).replace("CALL_S", str(s)) for name, s in servers)
        (folder / "drone.toml").write_text(text)
        fly = field.entered(*upwash, "fly", "--config", "drone.toml", "--log", "events.jsonl")
        with (folder / "fly.log").open("wb") as log:
            process = subprocess.Popen(fly, cwd=folder, stdout=log, stderr=log)
        try:
            yield Flight(folder, process)
        finally:
            process.kill()
            process.wait()


def test_each_way_to_fail_is_in_the_log_and_a_lost_carrier_cuts_a_call_at_once(
    field: Field, flight: Flight
) -> None:
    ready = flight.wait_for(lambda event: event.get("after") == "READY")
    assert ready["server"] == "s1"
    assert "10.91.1." in field.addresses()
    (flight.folder / "go").touch()
    called = flight.wait_for(lambda event: event["event"] == "decided")
    assert called["decision"] == "remote"
    field.cut_cable(1)
    assert flight.process.wait(timeout=PATIENCE_S) == 0, (flight.folder / "fly.log").read_text()

    failed = {event["server"]: event for event in flight.events("check_failed")}
    assert "no connection profile s3-net is on this drone" in failed["s3"]["why"]
    assert "s2-net cannot be joined: no address: nothing answered by DHCP" in failed["s2"]["why"]
    (joined,) = flight.events("joined")
    assert (joined["server"], joined["network"]) == ("s1", "s1-net")
    (lost,) = flight.events("network_lost")
    assert (lost["server"], lost["why"], lost["after"]) == ("s1", "its carrier is gone", "BLACKLISTED")
    times_s = [event["t"] for event in (failed["s3"], failed["s2"], joined, called, lost)]
    assert times_s == sorted(times_s)
    assert lost["t"] - called["t"] < DEADLINE_S / 2
    (cut,) = flight.events("remote_failed")
    assert cut["why"] == "s1: its network was lost: its carrier is gone"
    call = flight.events("call")[-1]
    assert (call["place"], call["fell_back"]) == ("local", True)
    assert call["delay_s"] < DEADLINE_S
    assert field.active() == ""


def test_ctrl_c_leaves_the_network(field: Field, flight: Flight) -> None:
    flight.wait_for(lambda event: event["event"] == "joined")
    flight.process.send_signal(signal.SIGINT)
    assert flight.process.wait(timeout=PATIENCE_S) == 130
    assert "10.91." not in field.addresses()
    assert field.active() == ""
