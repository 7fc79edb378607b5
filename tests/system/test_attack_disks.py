"""Too little room for what commands write: nothing is half made, and a flight goes on and is told as flown.

The system cuts what exceeds the limit of a file as a disk does that is full: some of a write is there, and the rest
fails. A command must say which file it could not write, leave what was there before, and nothing half-made.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import msgspec
import pytest
from tests.programs import COUNTER, COUNTING, ROOT, ended, stand_in, write_drone

from upwash.eventlog import log as event_log

pytestmark = [pytest.mark.system, pytest.mark.long]

SCENARIO = f"{ROOT}/scenarios/thesis.toml"
CALLS = 3
FLY = ("fly", "--config", "drone.toml")
LOG = ("--log", "events.jsonl")
AGILE = ("--acceleration", "50", "--param", "RTL_ALT=300")
ON_THE_DRONE = f"{CALLS} calls: {CALLS} on the drone"

LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
from upwash.cli.main import main
sys.exit(main(sys.argv[2:]))
"""

SERVER = """
listen = "127.0.0.1:0"
allow_without_certificates = true
[[service]]
name = "counter"
program = "mission.py:Counter"
[[server]]
name = "s1"
"""


def configured(folder: Path, vehicle: str = "udpout:127.0.0.1:1") -> Path:
    """The folder, with what the commands read."""
    plan = {"altitude_m": 3.0, "waypoints_m": [[10 * number, 0] for number in range(CALLS)]}
    service = COUNTER | {"local_call_s": 0.1}
    tables = {"autopilot": {"connection": vehicle}, "camera": {"photo_s": 0.1}, "service": [service]}
    write_drone(folder, COUNTING, mission=plan, **tables)
    (folder / "server.toml").write_text(SERVER)
    return folder


def limited(*arguments: str, most_bytes: int = resource.RLIM_INFINITY) -> list[str]:
    """A command whose files may have so many bytes."""
    return [sys.executable, "-B", "-c", LIMITED, str(most_bytes), *arguments]


# --- commands that leave files ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Writer:
    """A command, the room that each file has, the file that it cannot write, and what it prints all the same."""

    command: str
    most_bytes: int
    names: str
    prints: str = ""
    before: str = ""  # a command that runs before it, with room


FLOWN = f"simulate {SCENARIO} --log flown.jsonl"
KEYS = "keys keys --server s1 --drone heron"
PROFILE = "profile mission.py:Counter --photos photos --calls 1 --out out.x"
WRITERS = [
    Writer(f"simulate {SCENARIO} --log out.x", 5000, "out.x", prints="mission time"),
    Writer(f"simulate {SCENARIO} --figures figures", 5000, "map.png", prints="mission"),
    Writer("chaos --seed 1 --log out.x", 5000, "out.x"),
    Writer("chaos --seeds 1..2 --workers 1 --out out.x", 50, "out.x", prints="no promise broken"),
    Writer("report flown.jsonl -o out.x", 5000, "out.x", before=FLOWN),
    Writer("report flown.jsonl --csv out.x", 500, "out.x", before=FLOWN),
    Writer("report flown.jsonl --geojson out.x", 500, "out.x", before=FLOWN),
    Writer("report flown.jsonl --mcap out.x", 500, "out.x", before=FLOWN),
    Writer(PROFILE, 50, "out.x", prints="[[service]]"),
    Writer("check drone.toml --figures figures", 5000, "coverage.png"),
    Writer("package counter --config server.toml --output images", 100_000, "images"),
    Writer(KEYS, 100, "keys/authority.pem"),
    Writer("keys keys --drone stork", 300, "keys/stork.pem", before=KEYS),
    Writer("keys keys --revoke heron", 150, "keys/revoked.txt", before=KEYS),
    Writer("keys keys --new-authority", 700, "keys/authority.pem", before=KEYS),
    Writer("demo --folder demo", 100, "demo/keys/authority.pem"),
]


@pytest.mark.parametrize("writer", WRITERS, ids=lambda writer: writer.command.replace(SCENARIO, "thesis"))
def test_a_command_names_what_has_no_room_and_leaves_nothing_half_made(
    writer: Writer, tmp_path: Path
) -> None:
    folder = configured(tmp_path)
    if writer.before:
        assert ended(limited(*writer.before.split()), folder).returncode == 0
    require_whole(writer, folder)
    if writer.names == "out.x":
        (folder / "out.x").write_text("what was there before\n")
        require_whole(writer, folder)


def require_whole(writer: Writer, folder: Path) -> None:
    before = contents(folder)
    done = ended(limited(*writer.command.split(), most_bytes=writer.most_bytes), folder)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert writer.names in done.stderr.strip().rpartition("\n")[2]
    assert writer.prints in done.stdout
    assert contents(folder) == before, "something was left half made, or changed"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_a_campaign_keeps_the_rows_that_had_room_and_goes_on_from_there(tmp_path: Path) -> None:
    campaign = ("campaign", SCENARIO, "--seeds", "40", "--workers", "1", "--out", "out.csv")
    done = ended(limited(*campaign, most_bytes=3000), configured(tmp_path))
    assert done.returncode == 1
    assert "out.csv: cannot be written" in done.stderr
    kept = (tmp_path / "out.csv").read_bytes()
    assert kept.endswith(b"\n") and kept.count(b"\n") > 1, "it kept no rows, or tore one"
    again = ended(limited(*campaign), tmp_path)
    assert again.returncode == 0, again.stderr
    rows = (tmp_path / "out.csv").read_bytes()
    assert rows.count(b"\n") == 41
    assert set(kept.splitlines()) <= set(rows.splitlines()), "it lost rows that it had"


# --- flights ------------------------------------------------------------------------------------------------


@contextmanager
def flying(
    folder: Path,
    *options: str,
    most_bytes: int = resource.RLIM_INFINITY,
    out: int | BinaryIO = subprocess.PIPE,
) -> Iterator[subprocess.Popen[str]]:
    """A flight as a process of its own, past a stand-in, whose files may have so many bytes."""
    with stand_in(folder, *AGILE) as vehicle:
        command = limited(*FLY, *options, most_bytes=most_bytes)
        with subprocess.Popen(
            command, cwd=configured(folder, vehicle), stdout=out, stderr=subprocess.PIPE, text=True
        ) as process:
            try:
                yield process
            finally:
                process.kill()


def require_flown(code: int | None, said: str, *, kept: bool = True) -> None:
    """It is told as flown, and what its log lacks."""
    last = said.strip().rpartition("\n")[2]
    assert code == 3, said
    assert "the mission was flown to its end" in last
    assert kept or "lacks" in last


def require_whole_log(folder: Path, *, ends: str = "mission_completed") -> None:
    """Every line of the log is an event, and the one that it should end with is there, if any."""
    log = (folder / "events.jsonl").read_bytes()
    events = [event_log.decode(line) for line in log.splitlines()]
    times_s = [event.t for event in events]
    assert times_s == sorted(times_s)
    assert log.endswith(b"\n"), "the last line is torn"
    assert not ends or ends in [event.kind for event in events[-2:]]


def test_a_flight_whose_log_has_no_room_goes_on(tmp_path: Path) -> None:
    with flying(tmp_path, *LOG, most_bytes=2500) as process:
        printed, said = process.communicate(timeout=120)
    require_flown(process.returncode, said, kept=False)
    assert ON_THE_DRONE in printed
    assert f"{CALLS} of {CALLS} waypoints reached" in printed
    assert "the flight goes on" in said
    require_whole_log(tmp_path, ends="")


def test_the_object_of_a_flight_whose_log_has_no_room_has_all_that_was_flown(tmp_path: Path) -> None:
    with flying(tmp_path, *LOG, "--json", most_bytes=2500) as process:
        printed, said = process.communicate(timeout=120)
    require_flown(process.returncode, said, kept=False)
    result = msgspec.json.decode(printed)["result"]
    assert result["completed"] and len(result["calls"]) == CALLS


def test_a_log_that_has_room_again_before_the_end_lacks_nothing(tmp_path: Path) -> None:
    endless = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    with flying(tmp_path, *LOG, most_bytes=2500, out=subprocess.DEVNULL) as process:
        assert process.stderr is not None
        assert "has no room" in process.stderr.readline()
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, endless)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    require_whole_log(tmp_path)


def test_what_a_killed_flight_without_room_left_is_taken_up(tmp_path: Path) -> None:
    with flying(tmp_path, *LOG, most_bytes=2500, out=subprocess.DEVNULL) as first:
        assert first.stderr is not None
        first.stderr.readline()
        first.kill()
        second = ended(limited(*FLY, "--resume", "events.jsonl"), tmp_path)
    assert second.returncode == 0, second.stdout + second.stderr
    require_whole_log(tmp_path)


def full_disk() -> BinaryIO:
    return Path("/dev/full").open("wb")


def closed_pipe() -> BinaryIO:
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "wb")


@pytest.mark.parametrize("out", [full_disk, closed_pipe])
def test_a_flight_whose_output_is_lost_goes_on(tmp_path: Path, out: Callable[[], BinaryIO]) -> None:
    with out() as lost, flying(tmp_path, *LOG, out=lost) as process:
        _, said = process.communicate(timeout=120)
    require_flown(process.returncode, said)
    require_whole_log(tmp_path)


def test_a_flight_whose_log_lies_on_a_small_disk_goes_on(tmp_path: Path) -> None:
    make = 'mkdir -p small && mount -t tmpfs -o size=4k none small && "$@"'
    small = ("unshare", "-Urm", "sh", "-c", make, "sh")
    if shutil.which("unshare") is None or ended([*small, "true"], tmp_path).returncode:
        pytest.skip("this user may not make a disk in a namespace of its own")
    with stand_in(tmp_path, *AGILE) as vehicle:
        fly = limited(*FLY, "--log", "small/events.jsonl")
        done = ended([*small, *fly], configured(tmp_path, vehicle))
    require_flown(done.returncode, done.stderr, kept=False)
    assert ON_THE_DRONE in done.stdout
