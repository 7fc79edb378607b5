"""A program's log: one line a message, whatever others have put into it."""

from __future__ import annotations

import logging
import subprocess
import sys

import msgspec
import pytest

from upwash.real.host.log import RateLimitedLog

PROGRAM = r"""
import logging, sys
from upwash.real.host.log import log_json, log_text
{"text": log_text, "json": log_json}[sys.argv[1]]()
raw = "\x1b[2J\x9b31m\u202e\nall is well"
logging.getLogger("upwash.test").warning("%s said %s", "heron", raw)
try:
    raise ValueError(raw)
except ValueError:
    logging.getLogger("upwash.test").exception("failed")
"""
SHOWN = r"heron said \x1b[2J\x9b31m\u202e\nall is well"


def logged(form: str) -> list[str]:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, form], capture_output=True, timeout=30.0, check=True
    )
    return ended.stderr.decode().split("\n")


@pytest.mark.parametrize("form", ["text", "json"])
def test_nothing_that_is_not_printed_is_in_a_log(form: str) -> None:
    assert all(line.isprintable() for line in logged(form))


def test_a_message_is_one_line() -> None:
    assert logged("text")[0].endswith(f" WARNING upwash.test: {SHOWN}")
    first, second, *_ = map(msgspec.json.decode, filter(None, logged("json")))
    assert first["message"] == SHOWN
    assert r"ValueError: \x1b[2J\x9b31m\u202e" in second["traceback"]


def test_a_client_that_is_refused_for_a_day_fills_no_log_and_hides_nobody_else() -> None:
    now_s = 0.0
    limit = RateLimitedLog(now_s=lambda: now_s)

    def passes(whom: str) -> bool:
        record = logging.makeLogRecord({"msg": "refused %s", "args": (whom,), "whom": whom})
        if limit.filter(record):
            written.append(record.getMessage())
            return True
        return False

    written: list[str] = []
    for second in range(0, 86_400, 5):
        now_s = float(second)
        passes("heron")
    assert len(written) < 40
    assert written[0] == "refused heron"
    assert "left out before it" in written[-1]
    assert passes("stork")
    now_s += 3601.0
    assert passes("heron"), "after an hour of silence"
