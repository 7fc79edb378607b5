"""The end of a log that grows."""

from __future__ import annotations

import os
from pathlib import Path

from upwash.errors import UsageError
from upwash.eventlog.log import opened

_PIECE_BYTES = 2**16


class Tail:
    """Reads what a log gains; raises UsageError where it cannot be read."""

    def __init__(self, log: Path) -> None:
        self.at_end = False  # whether the last look came to the end of what the log had by then
        self._log = log
        try:
            self._file = opened(log)
        except OSError as error:
            raise UsageError(f"cannot read the event log {log}: {error.strerror}") from error

    def read(self) -> bytes | None:
        """The next 64 KB; None where there is nothing new."""
        content = self._file.read(_PIECE_BYTES)
        self.at_end = len(content) < _PIECE_BYTES
        return content or None

    def was_replaced(self) -> bool:
        """Whether another file bears the name now, or what was read is no longer in this one."""
        try:
            now = self._log.stat()
        except OSError:
            return False
        ours = os.fstat(self._file.fileno())
        return (now.st_dev, now.st_ino) != (ours.st_dev, ours.st_ino) or ours.st_size < self._file.tell()

    def close(self) -> None:
        """Lets go of the file."""
        self._file.close()
