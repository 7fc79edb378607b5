"""Notes when the machine was late: `python -m tests.system.faults.lateness FILE`, until it is killed.

It only sleeps, with the priority of the flight's programs: whenever it wakes up late, so would they.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

_PERIOD_S = 0.005
_WORTH_NOTING_S = 0.01


def main(file: Path) -> None:
    with file.open("w", buffering=1) as noted:
        while True:
            slept_s = time.monotonic()
            time.sleep(_PERIOD_S)
            late_s = time.monotonic() - slept_s - _PERIOD_S
            if late_s > _WORTH_NOTING_S:
                now_s = time.time()
                noted.write(f"{now_s - late_s} {now_s}\n")


@contextlib.contextmanager
def noting_lateness(file: Path) -> Iterator[None]:
    """Notes it in a process of its own until the end of the block."""
    with subprocess.Popen([sys.executable, "-m", "tests.system.faults.lateness", str(file)]) as process:
        try:
            yield
        finally:
            process.kill()


def read_lateness(file: Path) -> list[tuple[float, float]]:
    """From when to when the machine was late, by the time of day."""
    if not file.exists():
        return []
    return [(float(from_s), float(to_s)) for from_s, to_s in map(str.split, file.read_text().splitlines())]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
