"""Programs of others fly the stand-in: each takes off, flies a square, returns and lands.

They run as processes of their own: DroneKit changes the standard library, and MAVSDK starts threads.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest
from tests.programs import ROOT, ended, running

pytestmark = [pytest.mark.system, pytest.mark.long]

SPEEDUPS = {"arducopter": "20", "px4": "5"}  # a PX4 sends hundreds of messages a second by itself
SCHEMES = {
    "pymavlink": ("udpout:", "tcp:"),
    "dronekit": ("udpout:", "tcp:"),
    "mavsdk": ("udpout://", "tcpout://"),
}


FLOWN = [  # by the first transport at each push, by the other at night
    ("bare_pymavlink", "arducopter", "udp", "tcp"),
    ("mavsdk_square", "arducopter", "tcp", "udp"),
    ("bare_px4", "px4", "tcp", "udp"),
    ("mavsdk_square", "px4", "udp", "tcp"),
    ("dronekit_square", "arducopter", "udp", "tcp"),
]


@pytest.mark.parametrize(
    ("client", "autopilot", "transport"),
    [
        *((client, autopilot, first) for client, autopilot, first, _ in FLOWN),
        *(
            pytest.param(client, autopilot, other, marks=pytest.mark.nightly)
            for client, autopilot, _, other in FLOWN
        ),
    ],
)
def test_a_square_is_flown_by(client: str, autopilot: str, transport: str) -> None:
    (needs,) = (each for each in SCHEMES if each in client or (each, client) == ("pymavlink", "bare_px4"))
    if importlib.util.find_spec(needs) is None:
        pytest.skip(f"{needs} is not installed: pip install --group clients")
    command = ("vehicle", "--listen", f"{transport}:127.0.0.1:0", "--autopilot", autopilot)
    with running(*command, "--speedup", SPEEDUPS[autopilot], stderr=subprocess.PIPE) as vehicle:
        assert vehicle.stdout is not None
        assert vehicle.stderr is not None
        place = vehicle.stdout.readline().strip().partition(f" ready at {transport}:")[2]
        scheme = SCHEMES[needs][transport == "tcp"]
        program = [sys.executable, "-m", f"tests.system.clients.{client}"]
        done = ended([*program, scheme + place], ROOT)
        vehicle.terminate()
        assert vehicle.stderr.read() == ""
    told = [line for line in done.stdout.splitlines() if line in ("corner", "disarmed")]
    assert told == ["corner"] * 4 + ["disarmed"], done.stdout + done.stderr
