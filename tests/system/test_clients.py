"""Programs of others fly the stand-in: each takes off, flies a square, returns and lands.

They run as processes of their own: DroneKit changes the standard library, and MAVSDK starts threads.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.long]

CLIENTS = Path(__file__).parent / "clients"
SPEEDUPS = {"arducopter": 20, "px4": 5}  # a PX4 sends hundreds of messages a second by itself


@contextmanager
def vehicle(listen: str, autopilot: str) -> Iterator[str]:
    """Its host and port."""
    command = [sys.executable, "-m", "upwash", "vehicle", "--listen", listen, "--autopilot", autopilot]
    command += ["--speedup", str(SPEEDUPS[autopilot])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            _, _, address = process.stdout.readline().strip().partition(" ready at ")
            yield address.partition(":")[2]
        finally:
            process.terminate()
            complaints = process.stderr.read()
    assert complaints == ""


@pytest.mark.parametrize(
    ("client", "needs", "listen", "scheme", "autopilot"),
    [
        ("bare_pymavlink", "pymavlink", "udp", "udpout:", "arducopter"),
        ("bare_pymavlink", "pymavlink", "tcp", "tcp:", "arducopter"),
        ("mavsdk_square", "mavsdk", "udp", "udpout://", "arducopter"),
        ("mavsdk_square", "mavsdk", "tcp", "tcpout://", "arducopter"),
        ("bare_px4", "pymavlink", "udp", "udpout:", "px4"),
        ("bare_px4", "pymavlink", "tcp", "tcp:", "px4"),
        ("mavsdk_square", "mavsdk", "udp", "udpout://", "px4"),
        ("mavsdk_square", "mavsdk", "tcp", "tcpout://", "px4"),
        ("dronekit_square", "dronekit", "udp", "udpout:", "arducopter"),
        ("dronekit_square", "dronekit", "tcp", "tcp:", "arducopter"),
    ],
)
def test_a_square_is_flown_by(client: str, needs: str, listen: str, scheme: str, autopilot: str) -> None:
    if importlib.util.find_spec(needs) is None:
        pytest.skip(f"{needs} is not installed: pip install --group clients")
    with vehicle(f"{listen}:127.0.0.1:0", autopilot) as place:
        done = subprocess.run(
            [sys.executable, str(CLIENTS / f"{client}.py"), scheme + place],
            capture_output=True,
            text=True,
            timeout=90.0,
            check=False,
        )
    told = [line for line in done.stdout.splitlines() if line in ("corner", "disarmed")]
    assert told == ["corner"] * 4 + ["disarmed"], done.stdout + done.stderr
