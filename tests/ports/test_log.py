"""A program's log: one line a message, whatever others have put into it."""

from __future__ import annotations

import subprocess
import sys

import msgspec
import pytest

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
