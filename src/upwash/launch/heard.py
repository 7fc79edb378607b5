"""What services print while they are tried on the ground."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from upwash.support.text import printable

_MOST_LINES = 8  # a check calls several services, a profile only one
_LONGEST_LINE = 500  # characters


@dataclass(frozen=True, slots=True)
class Heard:
    """The first different lines, each after its service's name; warnings are apart."""

    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@contextmanager
def heard() -> Iterator[Heard]:
    """What services of this computer print in the block, in place of the log."""
    found = Heard()

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            instance, _, words = record.getMessage().partition(": ")
            line = printable(
                f"{instance.partition('@')[0]}: {words.removeprefix('warning: ')}", _LONGEST_LINE
            )
            lines = found.warnings if record.levelno >= logging.WARNING else found.lines
            if line not in lines and len(lines) < _MOST_LINES:
                lines.append(line)

    log, handler = logging.getLogger("upwash.instance"), Handler()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield found
    finally:
        log.setLevel(level)
        log.removeHandler(handler)
