"""A log that is larger than memory is reported all the same."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.events import line
from tests.programs import UPWASH, ended

pytestmark = [pytest.mark.system, pytest.mark.long]

SIZE_BYTES = 20_000_000
HERE = {"east_m": 0.0, "north_m": 0.0, "altitude_m": 20.0}
BOX = {"left_px": 1.5, "top_px": 2.5, "width_px": 30.0, "height_px": 40.0, "label": "cracked", "score": 0.9}
CALL = "detector.process_photo[heavy]"

# A process counts as its own what its parent held when it was started: so it is started by a small one.
_MEASURED = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(usage.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status))
"""


def places() -> Iterator[bytes]:
    """One each second."""
    for second in itertools.count(1):
        where = {"east_m": second % 977 * 0.37, "north_m": second % 1009 * 0.41, "altitude_m": 20.0}
        yield json.dumps({"t": second, "event": "position", **where}).encode() + b"\n"


def detections() -> Iterator[bytes]:
    """A photo each five seconds, with what is on it and what was seen on it."""
    for number in itertools.count(1):
        t = number * 5
        yield line("arrived", t, waypoint=number % 6)
        yield line("photo", t, source="1.jpg", position=HERE, truth=[BOX] * 60)
        yield line("decided", t, operation=CALL, decision="local", local_s=1.0, position=HERE)
        yield line("call", t + 1, operation=CALL, place="local", at_s=1.0, delay_s=1.0, onboard_s=1.0)
        yield line("notified", t + 1, message=[BOX] * 60, at=HERE)


# Python and imports take 30 MB, the facts of a page 16 MB. Findings are kept twice: for tables and
# files, and for the page, both as sightings and as objects.
@pytest.mark.parametrize(("kind", "most_mb"), [(places, 75), (detections, 175)])
def test_a_report_is_made_in_bounded_memory(
    tmp_path: Path, kind: Callable[[], Iterator[bytes]], most_mb: int
) -> None:
    log = tmp_path / "long.jsonl"
    with log.open("wb") as file:
        file.write(line("mission_started", 0.0, policy="local-only", waypoints=6))
        for each in kind():
            last = json.loads(each)["t"]
            if file.tell() >= SIZE_BYTES:
                break
            file.write(each)
        file.write(line("mission_completed", last))
    page, calls = tmp_path / "page.html", tmp_path / "calls.csv"
    report = (*UPWASH, "report", str(log), "-o", str(page), "--csv", str(calls))
    done = ended([sys.executable, "-c", _MEASURED, *report])
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) / 1024 < most_mb
