"""A flight whose networks the real NetworkManager joins: what the drone does, and what its event log says of it."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.events import read
from tests.programs import UPWASH, write_drone
from tests.system.daemons import config
from tests.system.radios import Field
from tests.waiting import wait_for

from upwash.launch.processes import ready_program
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

WORKBENCH = {"name": "workbench", "program": "services_for_tests.py:Workbench"}
MODES = ("light", "heavy", "pause")


def server(name: str, call_s: float) -> dict[str, Any]:
    """A server at the drone's home, in range all the time."""
    place = {"east_m": 0.0, "north_m": 0.0, "range_m": 1000.0, "address": "10.91.1.1:7070"}
    return {"name": name, "network": f"{name}-net", "remote_call_s": dict.fromkeys(MODES, call_s), **place}


@dataclass
class Flight:
    folder: Path
    process: subprocess.Popen[bytes]

    def events(self, *names: str) -> list[dict[str, Any]]:
        return read(self.folder / "events.jsonl", *names)

    def wait_for(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        found = wait_for(
            lambda: [event for event in self.events() if wanted(event)],
            within_s=PATIENCE_S,
            process=self.process,
            seen=self.events,
        )
        return found[0]


@pytest.fixture
def flight(field: Field, services: Path) -> Iterator[Flight]:
    """A drone among s3, which it has no profile for, s2, where nothing gives it an address, and s1, which is well."""
    folder = field.folder
    field.stop_dhcp(2)
    make_keys(folder / "keys", servers=[["s1"]], drones=["heron"])
    (folder / "services_for_tests.py").write_text(services.read_text())
    text = config(Path("keys"), listen="10.91.1.1:7070", service=[WORKBENCH], server=[{"name": "s1"}])
    (folder / "daemon.toml").write_text(text)
    serve = ("daemon", folder, "serve", "--config", "daemon.toml")
    vehicle = ("vehicle", folder, "vehicle", "--listen", "tcp:127.0.0.1:0", "--armable-after", "0")
    with (
        ready_program(*serve, through=field.entered(among="s1")),
        ready_program(*vehicle, through=field.entered()) as autopilot,
    ):
        local = WORKBENCH | {"local_call_s": dict.fromkeys(MODES, 20.0)}
        own = {"authority": "authority.pem", "certificate": "heron.pem", "key": "heron.key"}
        write_drone(
            folder,
            MISSION,
            autopilot={"connection": autopilot},
            network={"kind": "networkmanager", "interfaces": ["radio1", "radio2"]},
            keys={name: f"keys/{file}" for name, file in own.items()},
            service=[local],
            server=[server("s3", 0.1), server("s2", 0.2), server("s1", CALL_S)],
        )
        fly = field.entered(*UPWASH, "fly", "--config", "drone.toml", "--log", "events.jsonl")
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
