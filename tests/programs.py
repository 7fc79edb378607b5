"""Programs of this repository as processes, as their user runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tomli_w

ROOT = Path(__file__).parents[1]
UPWASH = (sys.executable, "-m", "upwash")
HOME = {"latitude_deg": 39.3666, "longitude_deg": 22.9507}
COUNTER = {"name": "counter", "program": "mission.py:Counter"}
COUNTING = """
from upwash import service

@service
class Counter:
    def count(self, photo: bytes) -> int:
        return len(photo)

def fly(drone):
    counter = drone.service(Counter)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        print("photo", waypoint.index, flush=True)
        drone.user.notify(counter.count(drone.camera.take_photo()), at=waypoint)
    drone.end_flight()
    drone.autopilot.disarm()
"""
_WIDE = {"COLUMNS": "200"}  # no table's cell is folded
_DRONE: dict[str, Any] = {
    "name": "heron",
    "mission": {"home": HOME, "waypoints_m": [[0, 0]]},
    "autopilot": {"connection": "udpout:127.0.0.1:1"},
    "camera": {"folder": "photos"},
}


def ended(command: Sequence[object], folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """How a program ended, and what it printed."""
    wide = os.environ | _WIDE
    return subprocess.run(
        [*map(str, command)],
        cwd=folder,
        env=wide,
        capture_output=True,
        text=True,
        check=False,
    )


def printed(module: str, *arguments: str | Path) -> str:
    """What `python -m MODULE ARGUMENTS` prints in the repository; it must end with 0."""
    done = ended([sys.executable, "-m", module, *arguments], ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def upwash(*arguments: str | Path, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """How a command of upwash ended in the folder."""
    return ended([*UPWASH, *arguments], folder)


@contextmanager
def running(
    *arguments: str | Path, folder: Path | None = None, **other: Any
) -> Iterator[subprocess.Popen[str]]:
    """A command of upwash as a process, which is killed at the end of the block; what it prints is in one pipe."""
    process: subprocess.Popen[str]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT} | other
    with subprocess.Popen(
        [*UPWASH, *arguments], cwd=folder, env=os.environ | _WIDE, text=True, **streams
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def stand_in(
    folder: Path, *options: str, listen: str = "udp:127.0.0.1:0", speedup: float = 4
) -> Iterator[str]:
    """The connection to a hasty vehicle that can be armed at once; its process is in the folder's vehicle.pid."""
    command = ("vehicle", "--listen", listen, "--speedup", f"{speedup:g}", "--armable-after", "0", *options)
    with running(*command, folder=folder, stderr=None) as process:
        assert process.stdout is not None
        (folder / "vehicle.pid").write_text(str(process.pid))
        yield process.stdout.readline().strip().partition(" ready at ")[2].replace("udp:", "udpout:")


def write_drone(folder: Path, program: str = "", **tables: Any) -> Path:
    """A drone's configuration, beside one photo and mission.py with the program.

    A table changes or adds to what there is: a home, a waypoint there, a vehicle that is not there, the photo.
    """
    (folder / "photos").mkdir(exist_ok=True)
    (folder / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    if program:
        (folder / "mission.py").write_text(program)
        tables["mission"] = {"program": "mission.py:fly", **tables.get("mission", {})}
    document = dict(_DRONE)
    for name, value in tables.items():
        document[name] = {**document.get(name, {}), **value} if isinstance(value, dict) else value
    (folder / "drone.toml").write_text(tomli_w.dumps(document))
    return folder / "drone.toml"
