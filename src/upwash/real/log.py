"""A program's log on standard error: text for people, or JSON lines for machines."""

from __future__ import annotations

import logging
import os
import sys
import threading
from datetime import UTC, datetime
from typing import TextIO

import msgspec

_TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_foreign = logging.getLogger("upwash.foreign")


def log_text() -> None:
    """From now on the log is text, as each library writes it."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format=_TEXT)


def log_json() -> None:
    """From now on each line on standard error is a JSON object, also what gRPC itself writes there.

    gRPC's core writes to file descriptor 2, past Python; it is read back through a pipe.
    """
    lines = os.fdopen(os.dup(2), "w", buffering=1)
    reading, writing = os.pipe()
    os.dup2(writing, 2)
    os.close(writing)
    sys.stderr = lines  # what Python says of a crash must get out at once
    handler = logging.StreamHandler(lines)
    handler.setFormatter(_JsonFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    threading.Thread(target=_pass_on, args=(os.fdopen(reading, errors="replace"),), daemon=True).start()


def _pass_on(foreign: TextIO) -> None:
    for line in foreign:
        if line.strip():
            _foreign.info("%s", line.strip())


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        facts = {
            "time": datetime.fromtimestamp(record.created, UTC),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            facts["traceback"] = self.formatException(record.exc_info)
        return msgspec.json.encode(facts).decode()
