"""Too little room: every command that leaves files runs where a file may have so many bytes and no more.

    python -m tests.system.attacks.full_disk

The system cuts what exceeds the limit as a disk does that is full: some of a write is there, and the rest fails.
A command must say which file it could not write, leave what was there before, and nothing half-made. A flight goes on
to its end, is told as flown, and leaves a log of whole lines.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import BinaryIO

import msgspec
from tests.programs import COUNTER, COUNTING, ROOT, ended, stand_in, write_drone

from upwash.eventlog import log as event_log

SCENARIO = f"{ROOT}/scenarios/thesis.toml"
FLOWN_NOT_KEPT = 3
CALLS = 3

_LIMITED = """
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


@dataclass
class Finding:
    """What an attack came to: how the command ended, its last words, and what of it breaks a promise."""

    code: int
    said: str
    broken: list[str] = field(default_factory=list)

    def expect(self, holds: bool, otherwise: str) -> None:
        """Notes what is broken unless that holds."""
        if not holds:
            self.broken.append(otherwise)


def prepare(folder: Path, vehicle: str = "udpout:127.0.0.1:1") -> None:
    """Puts what the commands read into the folder."""
    plan = {"altitude_m": 3.0, "waypoints_m": [[10 * number, 0] for number in range(CALLS)]}
    service = COUNTER | {"local_call_s": 0.1}
    tables = {"autopilot": {"connection": vehicle}, "camera": {"photo_s": 0.1}, "service": [service]}
    write_drone(folder, COUNTING, mission=plan, **tables)
    (folder / "server.toml").write_text(SERVER)


def upwash(
    folder: Path, *arguments: str, most_bytes: int = resource.RLIM_INFINITY
) -> subprocess.CompletedProcess[str]:
    """Runs a command whose files may have so many bytes."""
    return ended(_command(arguments, most_bytes), folder)


def _command(arguments: tuple[str, ...], most_bytes: int) -> list[str]:
    return [sys.executable, "-B", "-c", _LIMITED, str(most_bytes), *arguments]


# --- commands that leave files ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Writer:
    """A command, the room that each file has, the file that it cannot write, and what it prints all the same."""

    arguments: tuple[str, ...]
    most_bytes: int
    names: str
    prints: str = ""
    before: tuple[tuple[str, ...], ...] = ()  # commands that run before it, with room


_LOG = ("simulate", SCENARIO, "--log", "flown.jsonl")
_KEYS = ("keys", "keys", "--server", "s1", "--drone", "heron")
WRITERS = {
    "simulate --log": Writer(("simulate", SCENARIO, "--log", "out.x"), 5000, "out.x", prints="mission time"),
    "simulate --figures": Writer(("simulate", SCENARIO, "--figures", "figures"), 5000, "map.png", prints="mission"),
    "chaos --log": Writer(("chaos", "--seed", "1", "--log", "out.x"), 5000, "out.x"),
    "chaos --out": Writer(
        ("chaos", "--seeds", "1..2", "--workers", "1", "--out", "out.x"), 50, "out.x", prints="no promise broken"
    ),
    "report -o": Writer(("report", "flown.jsonl", "-o", "out.x"), 5000, "out.x", before=(_LOG,)),
    "report --csv": Writer(("report", "flown.jsonl", "--csv", "out.x"), 500, "out.x", before=(_LOG,)),
    "report --geojson": Writer(("report", "flown.jsonl", "--geojson", "out.x"), 500, "out.x", before=(_LOG,)),
    "report --mcap": Writer(("report", "flown.jsonl", "--mcap", "out.x"), 500, "out.x", before=(_LOG,)),
    "profile --out": Writer(
        ("profile", "mission.py:Counter", "--photos", "photos", "--calls", "1", "--out", "out.x"),
        50,
        "out.x",
        prints="[[service]]",
    ),
    "check --figures": Writer(("check", "drone.toml", "--figures", "figures"), 5000, "coverage.png"),
    "package": Writer(
        ("package", "counter", "--config", "server.toml", "--output", "images"), 100_000, "images"
    ),
    "keys": Writer(_KEYS, 100, "keys/authority.pem"),
    "keys, the second": Writer(("keys", "keys", "--drone", "stork"), 300, "keys/stork.pem", before=(_KEYS,)),
    "keys --revoke": Writer(("keys", "keys", "--revoke", "heron"), 150, "keys/revoked.txt", before=(_KEYS,)),
    "keys --new-authority": Writer(("keys", "keys", "--new-authority"), 700, "keys/authority.pem", before=(_KEYS,)),
    "demo": Writer(("demo", "--folder", "demo"), 100, "demo/keys/authority.pem"),
}  # fmt: skip


def attack_writer(writer: Writer, folder: Path) -> Finding:
    """Runs it with too little room, where its file is there already and where it is not."""
    for arguments in writer.before:
        upwash(folder, *arguments).check_returncode()
    finding = _attack(writer, folder)
    if writer.names == "out.x":
        (folder / "out.x").write_text("what was there before\n")
        finding.broken += _attack(writer, folder).broken
    return finding


def _attack(writer: Writer, folder: Path) -> Finding:
    before = _contents(folder)
    done = upwash(folder, *writer.arguments, most_bytes=writer.most_bytes)
    finding = Finding(done.returncode, done.stderr.strip().rpartition("\n")[2])
    finding.expect(done.returncode == 1, f"the exit code is {done.returncode}")
    finding.expect("Traceback" not in done.stderr, "it ended by a traceback")
    finding.expect(writer.names in finding.said, f"it does not name {writer.names}")
    finding.expect(writer.prints in done.stdout, f"it does not print {writer.prints!r}")
    after = _contents(folder)
    for file in sorted(before.keys() | after.keys()):
        finding.expect(before.get(file) == after.get(file), f"it left {file} half made or changed")
    return finding


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def attack_campaign(folder: Path) -> Finding:
    """A campaign keeps the rows that had room, whole, and the same command goes on from there."""
    campaign = ("campaign", SCENARIO, "--seeds", "40", "--workers", "1", "--out", "out.csv")
    done = upwash(folder, *campaign, most_bytes=4000)
    finding = Finding(done.returncode, done.stderr.strip().rpartition("\n")[2])
    finding.expect(done.returncode == 1, f"the exit code is {done.returncode}")
    finding.expect("out.csv: cannot be written" in done.stderr, "it does not name the file")
    kept = (folder / "out.csv").read_bytes()
    finding.expect(kept.endswith(b"\n") and kept.count(b"\n") > 1, "it kept no rows, or tore one")
    again = upwash(folder, *campaign)
    finding.expect(again.returncode == 0, f"it does not go on: {again.stderr}")
    rows = (folder / "out.csv").read_bytes()
    finding.expect(rows.count(b"\n") == 41, "it has not all rows in the end")
    finding.expect(all(row in rows.splitlines() for row in kept.splitlines()), "it lost rows that it had")
    return finding


# --- flights ------------------------------------------------------------------------------------------------


FLY = ("fly", "--config", "drone.toml")
LOG = ("--log", "events.jsonl")
AGILE = ("--acceleration", "50", "--param", "RTL_ALT=300")


@contextmanager
def flying(
    folder: Path,
    *options: str,
    most_bytes: int = resource.RLIM_INFINITY,
    out: int | BinaryIO = subprocess.PIPE,
) -> Iterator[subprocess.Popen[str]]:
    """A flight as a process of its own, past a stand-in, whose files may have so many bytes."""
    with stand_in(folder, *AGILE) as vehicle:
        prepare(folder, vehicle)
        command = _command((*FLY, *options), most_bytes)
        with subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.PIPE, text=True) as process:
            try:
                yield process
            finally:
                process.kill()


def attack_flight(folder: Path) -> Finding:
    """The disk is full soon after take-off, and stays so."""
    with flying(folder, *LOG, most_bytes=2500) as process:
        printed, said = process.communicate(timeout=120)
    finding = _flown(process.returncode, said, kept=False)
    finding.expect(f"{CALLS} calls: {CALLS} on the drone" in printed, "the result lacks calls")
    finding.expect(f"{CALLS} of {CALLS} waypoints reached" in printed, "the result lacks a waypoint")
    finding.expect("the flight goes on" in said, "it is not told when the log has no room")
    _expect_whole(folder / "events.jsonl", finding, ends="")
    return finding


def attack_printed_result(folder: Path) -> Finding:
    """The same with --json: the object has all that was flown."""
    with flying(folder, *LOG, "--json", most_bytes=2500) as process:
        printed, said = process.communicate(timeout=120)
    finding = _flown(process.returncode, said, kept=False)
    result = msgspec.json.decode(printed)["result"]
    finding.expect(result["completed"] and len(result["calls"]) == CALLS, "the object lacks what was flown")
    return finding


def attack_until_there_is_room(folder: Path) -> Finding:
    """The disk is full in flight, and has room again before its end: the log lacks nothing."""
    endless = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    with flying(folder, *LOG, most_bytes=2500, out=subprocess.DEVNULL) as process:
        assert process.stderr is not None
        first_line = process.stderr.readline()
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, endless)
        _, said = process.communicate(timeout=120)
    finding = Finding(process.returncode, said.strip())
    finding.expect("has no room" in first_line, f"it said first: {first_line}")
    finding.expect(process.returncode == 0, f"the exit code is {process.returncode}")
    _expect_whole(folder / "events.jsonl", finding, ends="mission_completed")
    return finding


def attack_and_kill(folder: Path) -> Finding:
    """The disk is full in flight, and the program is killed: what it left is taken up."""
    with flying(folder, *LOG, most_bytes=2500, out=subprocess.DEVNULL) as first:
        assert first.stderr is not None
        first.stderr.readline()
        first.kill()
        second = upwash(folder, *FLY, "--resume", "events.jsonl")
    finding = Finding(second.returncode, second.stderr.strip())
    finding.expect(
        second.returncode == 0, f"the exit code is {second.returncode}: {second.stdout}{second.stderr}"
    )
    _expect_whole(folder / "events.jsonl", finding, ends="mission_completed")
    return finding


def attack_output(folder: Path, out: Callable[[], BinaryIO]) -> Finding:
    """What the flight and its mission print goes to a full disk, or to a pipe that nobody reads any more."""
    with out() as lost, flying(folder, *LOG, out=lost) as process:
        _, said = process.communicate(timeout=120)
    finding = _flown(process.returncode, said)
    _expect_whole(folder / "events.jsonl", finding, ends="mission_completed")
    return finding


def _full() -> BinaryIO:
    return Path("/dev/full").open("wb")


def _closed() -> BinaryIO:
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "wb")


def attack_small_disk(folder: Path) -> Finding | None:
    """The log lies on a disk of 4 KB; None where this user may not make one."""
    make = 'mkdir -p small && mount -t tmpfs -o size=4k none small && "$@"'
    small = ("unshare", "-Urm", "sh", "-c", make, "sh")
    if shutil.which("unshare") is None or ended([*small, "true"], folder).returncode:
        return None
    with stand_in(folder, *AGILE) as vehicle:
        prepare(folder, vehicle)
        fly = _command((*FLY, "--log", "small/events.jsonl"), resource.RLIM_INFINITY)
        done = ended([*small, *fly], folder)
    finding = _flown(done.returncode, done.stderr, kept=False)
    finding.expect(f"{CALLS} calls: {CALLS} on the drone" in done.stdout, "the result lacks calls")
    return finding


FLIGHTS: dict[str, Callable[[Path], Finding | None]] = {
    "fly, no room for the log": attack_flight,
    "fly --json, no room for the log": attack_printed_result,
    "fly, no room for the log for a while": attack_until_there_is_room,
    "fly, no room for the log, killed, --resume": attack_and_kill,
    "fly, a log on a disk of 4 KB": attack_small_disk,
    "fly, standard output full": partial(attack_output, out=_full),
    "fly, standard output closed": partial(attack_output, out=_closed),
}


def _flown(code: int, said: str, *, kept: bool = True) -> Finding:
    finding = Finding(code, said.strip().rpartition("\n")[2])
    finding.expect(code == FLOWN_NOT_KEPT, f"the exit code is {code}: {said}")
    finding.expect("the mission was flown to its end" in finding.said, "it is not told as flown")
    finding.expect(kept or "lacks" in finding.said, "it does not say what the log lacks")
    return finding


def _expect_whole(log: Path, finding: Finding, *, ends: str) -> None:
    """Every line of the log is an event, and the one that it is to end with is there, if any."""
    events = [event_log.decode(line) for line in log.read_bytes().splitlines()]
    times_s = [event.t for event in events]
    finding.expect(times_s == sorted(times_s), "the log's times do not ascend")
    finding.expect(log.read_bytes().endswith(b"\n"), "the log's last line is torn")
    names = [event.kind for event in events]
    finding.expect(not ends or ends in names[-2:], f"the log does not end with {ends}")


ATTACKS: dict[str, Callable[[Path], Finding | None]] = {
    **{name: partial(attack_writer, writer) for name, writer in WRITERS.items()},
    "campaign": attack_campaign,
    **FLIGHTS,
}


def attack(name: str, folder: Path) -> Finding | None:
    """Makes the attack of that name in the folder, which is empty; None where it cannot be made here."""
    prepare(folder)
    return ATTACKS[name](folder)


def main() -> int:
    """Prints the table; returns how many attacks broke something."""
    broken = 0
    print("| attack | exit code | said | broken |\n|---|---|---|---|")
    for name in ATTACKS:
        with tempfile.TemporaryDirectory() as folder:
            finding = attack(name, Path(folder))
        if finding is not None:
            broken += bool(finding.broken)
            print(f"| {name} | {finding.code} | {finding.said} | {'; '.join(finding.broken)} |", flush=True)
    return broken


if __name__ == "__main__":
    sys.exit(main())
