"""A log of a flight without end: `python -m tests.system.attacks.long_log [MB]`.

Has `upwash report` make what it can of two such logs, of places alone and of photos with many detections, and prints
the most memory and the time that each took.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = {"east_m": 0.0, "north_m": 0.0, "altitude_m": 20.0}
BOX = {"left_px": 1.5, "top_px": 2.5, "width_px": 30.0, "height_px": 40.0, "label": "cracked", "score": 0.9}
CALL = {
    "event": "call", "operation": "detector.process_photo[heavy]", "place": "local", "decision": "no server selected",
    "at_s": 1.0, "delay_s": 1.0, "waited_s": 0.0, "onboard_s": 1.0, "wait": "", "fell_back": False,
}  # fmt: skip
DECIDED = {
    "event": "decided", "operation": CALL["operation"], "decision": "local", "why": "no server selected",
    "local_s": 1.0, "selected": None, "state": None, "remote_s": None, "check_s": None, "check_elapsed_s": None,
    "position": HERE,
}  # fmt: skip

# A process counts as its own what its parent held when it was started: so it is started by a small one.
_MEASURED = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(usage.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status))
"""


def places() -> Iterator[dict[str, Any]]:
    """One each second."""
    for second in itertools.count(1):
        where = {"east_m": second % 977 * 0.37, "north_m": second % 1009 * 0.41, "altitude_m": 20.0}
        yield {"t": second, "event": "position", **where}


def detections() -> Iterator[dict[str, Any]]:
    """A photo each five seconds, with what is on it and what was seen on it."""
    for number in itertools.count(1):
        t = number * 5
        yield {"t": t, "event": "arrived", "waypoint": number % 6, "east_m": 0.0, "north_m": 0.0}
        yield {
            "t": t,
            "event": "photo",
            "source": "1.jpg",
            "bytes": 1,
            "age_s": 0.0,
            "position": HERE,
            "truth": [BOX] * 60,
        }
        yield {"t": t, **DECIDED}
        yield {"t": t + 1, **CALL}
        yield {"t": t + 1, "event": "notified", "message": [BOX] * 60, "at": HERE}


KINDS = {"places": places, "detections": detections}


def write_log(file: Path, kind: str, size_bytes: int) -> None:
    """A flight whose log has about that size."""
    began = {"t": 0.0, "event": "mission_started", "policy": "local-only", "waypoints": 6, "done": []}
    with file.open("w") as log:
        log.write(json.dumps(began) + "\n")
        event: dict[str, Any] = began
        for event in KINDS[kind]():
            if log.tell() >= size_bytes:
                break
            log.write(json.dumps(event) + "\n")
        log.write(json.dumps({"t": event["t"], "event": "mission_completed"}) + "\n")


def report(log: Path, *outputs: str) -> tuple[float, float]:
    """The most memory that `upwash report` held, in MB, and the seconds it took."""
    began_s = time.monotonic()
    command = [sys.executable, "-c", _MEASURED, sys.executable, "-m", "upwash", "report", str(log), *outputs]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
    return int(done.stdout) / 1024, time.monotonic() - began_s


def main(megabytes: float) -> None:
    """Measures both logs."""
    with tempfile.TemporaryDirectory() as folder:
        log, page = Path(folder, "long.jsonl"), str(Path(folder, "page.html"))
        for kind in KINDS:
            write_log(log, kind, round(megabytes * 1e6))
            for outputs in (("--json",), ("-o", page)):
                memory_mb, took_s = report(log, *outputs)
                sys.stdout.write(
                    f"{megabytes:g} MB of {kind}, report {outputs[0]}: {memory_mb:.0f} MB, {took_s:.1f} s\n"
                )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 100)
