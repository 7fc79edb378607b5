"""Fuzzes one decoder in this process: `python -m tests.fuzz.harness NAME SEED SECONDS CURRENT KEPT`; see campaign.py.

Before each run the input is in the file CURRENT: what kills or holds up the process is found there. Inputs that break
the decoder otherwise are kept in the folder KEPT, one for each way of breaking it.
"""

from __future__ import annotations

import mmap
import random
import re
import resource
import sys
import time
import traceback
from pathlib import Path

from tests.fuzz.decoders import Broken, Decoder, decoders
from tests.fuzz.mutations import LONGEST_BYTES, mutated

CURRENT_BYTES = 12 + LONGEST_BYTES  # the number of the run, the length of the input, the input
_MOST_KEPT = 400  # inputs that others are made of
_LONGEST_KEPT = 20_000
_PARTICULARS = re.compile(r"\d+|'[^']*'|\"[^\"]*\"|\S{40,}")  # of a message: numbers, and what it quotes


class Harness:
    """Runs a decoder on inputs made of those that gave another outcome than all before."""

    def __init__(self, name: str, decoder: Decoder, *, seed: int, current: mmap.mmap, kept: Path) -> None:
        self.runs = 0
        self._name, self._decoder, self._kept = name, decoder, kept
        self._chance = random.Random(seed)
        self._current = current
        self._inputs = list(decoder.understood)
        self._outcomes: set[str] = set()
        self._broken: set[str] = set()

    def run(self) -> None:
        """One more input."""
        data = mutated(self._chance, self._inputs)
        self.runs += 1
        self._current[:12] = self.runs.to_bytes(8) + len(data).to_bytes(4)
        self._current[12 : 12 + len(data)] = data
        try:
            outcome = self._decoder.feed(data)
        except Broken as broken:
            self._keep(broken, data)
            return
        outcome = _PARTICULARS.sub("", outcome)[:100]
        if outcome not in self._outcomes and len(data) <= _LONGEST_KEPT and len(self._inputs) < _MOST_KEPT:
            self._outcomes.add(outcome)
            self._inputs.append(data)

    def _keep(self, broken: Broken, data: bytes) -> None:
        why = _PARTICULARS.sub("", f"{broken} {_place(broken)}")[:200]
        if why not in self._broken:
            self._broken.add(why)
            file = (
                self._kept
                / f"{self._name.replace(' ', '-')}-{len(self._broken)}-{self._chance.randrange(10**6)}"
            )
            file.write_bytes(data)
            print(f"{self._name}: {broken}: {file} ({len(data)} bytes)")
            print(
                "".join(traceback.format_exception(broken.__cause__)[-6:])[-1500:] if broken.__cause__ else ""
            )


def _place(broken: Broken) -> str:
    """The last line of code that was reached."""
    frames = traceback.extract_tb(broken.__cause__.__traceback__) if broken.__cause__ else []
    return f"{frames[-1].name} {frames[-1].line}" if frames else ""


def main() -> None:
    name, seed, seconds, current, kept = sys.argv[1:]
    decoder = decoders()[name]
    for data in decoder.understood:
        decoder.decode(data)  # what is imported and made once counts for nothing
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    most = held + decoder.most_bytes
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    with Path(current).open("r+b") as file, mmap.mmap(file.fileno(), CURRENT_BYTES) as shared:
        harness = Harness(name, decoder, seed=int(seed), current=shared, kept=Path(kept))
        end_s = time.monotonic() + float(seconds)
        while time.monotonic() < end_s:
            harness.run()


if __name__ == "__main__":
    main()
