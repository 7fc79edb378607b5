"""Fuzzes decoders for as long as one likes: `python -m tests.fuzz --decoder NAME --seconds 120`.

Each decoder runs in a process of its own, within the memory that the table allows. What breaks one is printed; its
input is kept.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
from bench.results import leave
from tests.fuzz.decoders import decoders
from tests.fuzz.harness import CURRENT_BYTES

_HUNG_S = 20.0  # of the processor, for one input: others may keep it busy
_POLL_S = 0.5


class Fuzzed(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one decoder."""

    harness: str
    seconds: float
    runs: int
    findings: int


def fuzz(name: str, *, seconds: float, kept: Path, seed: int = 1) -> Fuzzed:
    """Fuzzes the decoder of that name; inputs that break it are kept in the folder."""
    runs = 0
    with tempfile.TemporaryDirectory() as folder:
        current, found = Path(folder, "current"), Path(folder, "found")
        found.mkdir()
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            current.write_bytes(bytes(CURRENT_BYTES))
            ended = _run(name, seed, left_s, current, found)
            seed += 1
            with current.open("rb") as file:
                done, length = int.from_bytes(file.read(8)), int.from_bytes(file.read(4))
                data = file.read(length)
            runs += done
            if ended:
                file_name = f"{name.replace(' ', '-')}-{ended.replace(' ', '-')}-{seed}"
                (found / file_name).write_bytes(data)
                print(f"{name}: the process {ended}: {file_name} ({length} bytes)", flush=True)
        findings = list(found.iterdir())
        for finding in findings:
            (kept / finding.name).write_bytes(finding.read_bytes())
    return Fuzzed(harness=name, seconds=seconds, runs=runs, findings=len(findings))


def _run(name: str, seed: int, seconds: float, current: Path, found: Path) -> str:
    """One process; returns how it ended before its time, "" where it did not."""
    arguments = map(str, (name, seed, seconds, current, found))
    command = [sys.executable, "-m", "tests.fuzz.harness", *arguments]
    with subprocess.Popen(command) as process:
        before, since_s = b"", 0.0
        while process.poll() is None:
            time.sleep(_POLL_S)
            with current.open("rb") as file:
                number = file.read(8)
            if number != before:
                before, since_s = number, _processor_s(process.pid)
            elif _processor_s(process.pid) - since_s > _HUNG_S:
                process.kill()
                return f"hung for {_HUNG_S:g} s"
    if process.returncode < 0:
        return f"was ended by {signal.Signals(-process.returncode).name}"
    return f"ended with {process.returncode}" if process.returncode else ""


def _processor_s(pid: int) -> float:
    """What a process has used of the processor, 0 once it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "--decoder", action="append", metavar="NAME", choices=decoders(), help="which (default: all)"
    )
    parser.add_argument("--seconds", type=float, default=120, help="for each (default 120)")
    parser.add_argument("--seed", type=int, default=1, help="another one makes other inputs (default 1)")
    parser.add_argument("--findings", type=Path, default=Path(), help="where inputs that break one are kept")
    parser.add_argument("--out", type=Path, help="leave the figures there as JSON")
    options = parser.parse_args()
    figures = []
    for name in options.decoder or decoders():
        figures.append(fuzz(name, seconds=options.seconds, kept=options.findings, seed=options.seed))
        print(f"{name}: {figures[-1].runs:,} inputs, {figures[-1].findings} findings", flush=True)
    if options.out:
        leave(options.out, command=f"python -m tests.fuzz --seconds {options.seconds:g}", figures=figures)
    return min(1, sum(figure.findings for figure in figures))
