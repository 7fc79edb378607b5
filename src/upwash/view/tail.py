"""The end of a log that grows."""

from __future__ import annotations

import os
from pathlib import Path

from upwash.errors import UsageError
from upwash.eventlog.log import LONGEST_LINE_BYTES

_CHUNK_BYTES = 2**16


class Tail:
    """Reads what a log gains, whole lines only; raises UsageError where it cannot be read."""

    def __init__(self, log: Path) -> None:
        self.at_end = False  # whether the last look came to the end of what the log had by then
        self._log = log
        self._rest = b""
        try:
            self._file = log.open("rb")
        except OSError as error:
            raise UsageError(f"cannot read the event log {log}: {error.strerror}") from error

    def read(self) -> bytes | None:
        """The lines that end in the next 64 KB, with their ends; None where there is nothing new."""
        chunk = self._file.read(_CHUNK_BYTES)
        self.at_end = len(chunk) < _CHUNK_BYTES
        if not chunk:
            return None
        lines, end, self._rest = (self._rest + chunk).rpartition(b"\n")
        if len(self._rest) > LONGEST_LINE_BYTES:
            raise UsageError(f"{self._log} is not an event log: it has a line of more than 16 MiB")
        return lines + end

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
