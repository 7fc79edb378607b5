"""A program's log on standard error: text for people, or JSON lines for machines."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import msgspec

from upwash.core.admission.limits import Allowance
from upwash.support.background import thread
from upwash.support.text import counted, escaped_lines, printable

_TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_LONGEST_MESSAGE = 10_000
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 3600.0  # between two lines of one client
_MOST_CLIENTS = 1024
_foreign = logging.getLogger("upwash.foreign")


def log_text() -> None:
    """Makes the log text, one line a message, even if drones or services put line ends into it."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_TextFormatter(_TEXT))
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def log_json() -> None:
    """Makes each line on standard error a JSON object, also lines that libraries write.

    Libraries write to file descriptor 2, past Python; it is read back through a pipe.
    """
    lines = os.fdopen(os.dup(2), "w", buffering=1)
    reading, writing = os.pipe()
    os.dup2(writing, 2)
    os.close(writing)
    sys.stderr = lines  # Python's report of a crash must get out at once
    handler = logging.StreamHandler(lines)
    handler.setFormatter(_JsonFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    foreign = os.fdopen(reading, errors="replace")

    def write_past(_: Exception) -> None:  # or a library that writes would wait for ever
        os.dup2(lines.fileno(), 2)

    def pass_on() -> None:
        for line in foreign:
            if line.strip():
                _foreign.info("%s", line.strip())

    thread(pass_on, name="log of libraries", failed=write_past).start()


class _TextFormatter(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's name
        record.message = printable(record.message, _LONGEST_MESSAGE)
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:  # noqa: N802 - logging's name
        return escaped_lines(super().formatException(ei))


class _JsonFormatter(_TextFormatter):
    def format(self, record: logging.LogRecord) -> str:
        facts = {
            "time": datetime.fromtimestamp(record.created, UTC),
            "level": record.levelname,
            "logger": record.name,
            "message": printable(record.getMessage(), _LONGEST_MESSAGE),
        }
        if record.exc_info:
            facts["traceback"] = self.formatException(record.exc_info)
        return msgspec.json.encode(facts).decode()


@dataclass(slots=True)
class _Lines:
    """The lines of one client: the last one, until when they are left out, how long next time, and how many were."""

    seen_s: float = -math.inf
    until_s: float = -math.inf
    pause_s: float = _FIRST_PAUSE_S
    left_out: int = 0


class RateLimitedLog(logging.Filter):
    """Lets five lines a second through, 50 after a rest; the next line has the number of those left out.

    Of one client, which a line names by `extra={"whom": client}`, a line comes through at once, and others after
    pauses that double from 1 s to 1 h. After an hour without a line of the client its pauses begin at 1 s again.
    """

    def __init__(self, *, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = now_s
        self._lines = Allowance(5.0, at_once=50.0)
        self._left_out = 0
        self._of: OrderedDict[str, _Lines] = OrderedDict()  # by client, the latest last

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written."""
        now_s, whom = self._now_s(), getattr(record, "whom", None)
        client = None if whom is None else self._client(whom, now_s)
        if client is not None and now_s < client.until_s:
            client.left_out += 1
            return False
        if not self._lines.take(1, now_s=now_s):
            self._left_out += 1
            return False
        left_out, self._left_out = self._left_out, 0
        if client is not None:
            left_out, client.left_out = left_out + client.left_out, 0
            client.until_s, client.pause_s = now_s + client.pause_s, min(2 * client.pause_s, _LONGEST_PAUSE_S)
        if left_out:
            record.msg = f"{record.getMessage()} ({counted(left_out, 'line')} left out before it)"
            record.args = ()
        return True

    def _client(self, whom: str, now_s: float) -> _Lines:
        known = self._of.pop(whom, None)
        if known is None or now_s - known.seen_s > _LONGEST_PAUSE_S:
            known = _Lines()
        known.seen_s = now_s
        self._of[whom] = known
        if len(self._of) > _MOST_CLIENTS:
            self._of.popitem(last=False)
        return known
