"""A file of lines that grows: each line is in it whole, whatever becomes of the disk."""

from __future__ import annotations

import fcntl
import os
import stat
from collections import deque
from pathlib import Path

from upwash.errors import UsageError
from upwash.support.output_files import append_whole

_MOST_BYTES = 2**25  # held back in memory: some hours of a flight


class Unwritten:
    """The lines that a file has had no room for, in their order; `why` it lacks something, empty where it does not.

    More than fits into memory is not held but counted: it is `lost`.
    """

    def __init__(self) -> None:
        self.lines: deque[bytes] = deque()
        self.lost = 0
        self.why = ""
        self._size_bytes = 0

    def add(self, line: bytes) -> None:
        """Holds another line."""
        if self.lost or self._size_bytes + len(line) > _MOST_BYTES:
            self.lost += 1
            return
        self._size_bytes += len(line)
        self.lines.append(line)

    def written(self) -> None:
        """The first line is in the file now."""
        self._size_bytes -= len(self.lines.popleft())

    def __len__(self) -> int:
        """How many lines the file lacks."""
        return len(self.lines) + self.lost


class LogFile:
    """Lines that one process at a time appends to a file; raises OSError, or UsageError where another one does."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            _lock(self._file, path)
            self._size_bytes = os.fstat(self._file).st_size
            self._is_torn = self._end_of_last_line() != self._size_bytes
        except BaseException:
            os.close(self._file)
            raise

    def cut_torn_line(self) -> None:
        """Drops a last line that was left unfinished."""
        self._size_bytes = self._end_of_last_line()
        os.ftruncate(self._file, self._size_bytes)
        self._is_torn = False

    def append(self, line: bytes) -> None:
        """Adds one line, in one write; raises OSError where it is not in the file then.

        A line that was cut is taken back. Where even that fails, the next one closes it first.
        """
        content = (b"\n" if self._is_torn else b"") + line + b"\n"
        try:
            append_whole(self._file, content)
        except OSError:
            size_bytes = os.fstat(self._file).st_size
            self._is_torn |= size_bytes != self._size_bytes
            self._size_bytes = size_bytes
            raise
        self._size_bytes += len(content)
        self._is_torn = False

    def close(self) -> None:
        """Ends the file; raises OSError where the system says only now that it did not keep it."""
        os.close(self._file)

    def _end_of_last_line(self) -> int:
        """How many bytes whole lines take."""
        if not stat.S_ISREG(os.fstat(self._file).st_mode):
            return self._size_bytes
        end_bytes = self._size_bytes
        while end_bytes:
            piece_bytes = min(end_bytes, 65_536)
            found = os.pread(self._file, piece_bytes, end_bytes - piece_bytes).rfind(b"\n")
            if found >= 0:
                return end_bytes - piece_bytes + found + 1
            end_bytes -= piece_bytes
        return 0


def _lock(file: int, path: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(
            f"another program is writing the event log {path}: is the flight still under way?"
        ) from None
