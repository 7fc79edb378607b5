"""Fuzzes every decoder with atheris: `python -m tests.fuzz.campaign --seconds 120`, with the dependency group `fuzz`.

What a decoder must not do is printed, with the input that made it do so.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec
from bench.results import leave
from tests.fuzz.decoders import decoders

_LONGEST_BYTES = 20_000
_SLOWEST_S = 10  # for one input
_MOST_MB = 2_000


class Fuzzed(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one decoder."""

    harness: str
    seconds: float
    runs: int
    findings: int


def fuzz(name: str, *, seconds: int, kept: Path) -> Fuzzed:
    """Fuzzes the decoder of that name; an input that breaks it is kept in the folder."""
    with tempfile.TemporaryDirectory() as corpus:
        done = subprocess.run(
            [
                *(sys.executable, "-m", "tests.fuzz.harness", name, corpus),
                *(f"-max_total_time={seconds}", f"-max_len={_LONGEST_BYTES}", f"-timeout={_SLOWEST_S}"),
                *(f"-rss_limit_mb={_MOST_MB}", f"-artifact_prefix={kept}/{name.replace(' ', '-')}-"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
        )
    runs = re.findall(r"^(?:Done |#)(\d+)", done.stdout, re.MULTILINE)
    if done.returncode != 0:
        print(done.stdout[-3000:])
    return Fuzzed(
        harness=name,
        seconds=seconds,
        runs=int(runs[-1]) if runs else 0,
        findings=int(done.returncode != 0),
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.campaign", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="DECODER", help="which (default: all)")
    parser.add_argument("--seconds", type=int, default=120, help="for each (default 120)")
    parser.add_argument("--findings", type=Path, default=Path(), help="where inputs that break one are kept")
    parser.add_argument("--out", type=Path, help="leave the figures there as JSON")
    options = parser.parse_args()
    figures = []
    for name in options.names or decoders():
        figures.append(fuzz(name, seconds=options.seconds, kept=options.findings))
        print(f"{name}: {figures[-1].runs:,} inputs, {figures[-1].findings} findings", flush=True)
    if options.out:
        command = f"python -m tests.fuzz.campaign --seconds {options.seconds}"
        leave(options.out, command=command, figures=figures)
    return sum(each.findings for each in figures)


if __name__ == "__main__":
    sys.exit(main())
