"""The output of a service instance: logged line by line, up to a rate; its last lines explain a crash."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import time
from collections.abc import AsyncIterator, Callable

from upwash.core.admission.limits import Allowance
from upwash.support.text import signal_name, words_of

_log = logging.getLogger("upwash.instance")

_LAST_WORDS = 5  # lines
_LONGEST_LINE = 1000  # bytes; what is longer is several
_LINE = re.compile(rb"[^\r\n]{1,%d}" % _LONGEST_LINE)
_LOGGED_BYTES_S = 2048.0  # a log may be kept for months
_LOGGED_AT_ONCE_BYTES = 2**16  # a traceback, or all that a library says of its start
_LINE_COSTS_BYTES = 100  # what a log adds to each line
_CHUNK_BYTES = 2**16
_WARNING = b"warning: "
_READ_BYTES_S = 2.0**25  # faster than any service prints that does its work too
_READ_AT_ONCE_BYTES = 2**28  # read in a fraction of a second


async def chunks_of(prints: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """The output of an instance until it ends.

    A service that prints more than 32 MiB/s has to wait, or it would keep this program from its own work.
    """
    pace, now_s = Allowance(_READ_BYTES_S, at_once=_READ_AT_ONCE_BYTES), asyncio.get_running_loop().time
    with contextlib.suppress(ConnectionError):
        while chunk := await prints.read(_CHUNK_BYTES):
            yield chunk
            await asyncio.sleep(pace.take_anyway_s(len(chunk), now_s=now_s()))


def last_of(printed: bytes) -> bytes:
    """The end of the output, with its last lines."""
    return printed[-_LAST_WORDS * (_LONGEST_LINE + 1) :]


class InstanceOutput:
    """The output of the instance of that name, progress bars and endless lines included."""

    def __init__(self, name: str, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._name = name
        self._now_s = now_s
        self._rest = b""
        self._last = b""
        self._logged = Allowance(_LOGGED_BYTES_S, at_once=_LOGGED_AT_ONCE_BYTES)
        self._left_out = 0  # bytes, since the last line that was logged

    def add(self, chunk: bytes, *, left_out: int = 0) -> None:
        """Log the next output, which follows `left_out` dropped bytes.

        Beyond the rate the rest is not split into lines: there may be very many.
        """
        self._last = last_of(self._last + last_of(chunk))
        self._left_out += left_out
        text, self._rest = self._rest + chunk, b""
        for found in _LINE.finditer(text):
            words = found[0]
            if found.end() == len(text) and len(words) < _LONGEST_LINE:
                self._rest = words  # the line may go on
            elif words.strip() and not self._note(words):
                self._left_out += len(text) - found.start()
                return

    def explain(self, code: int) -> str:
        """How a process with this output ended, by its exit code, negative for a signal."""
        self.close()
        how = f"killed by {signal_name(-code)}" if code < 0 else f"ended with code {code}"
        last = [words for words in _LINE.findall(self._last) if words.strip()][-_LAST_WORDS:]
        return f"{how}: {' / '.join(map(_words, last))}" if last else how

    def close(self) -> None:
        """Log an unfinished line, and the number of bytes that were left out."""
        self.add(b"\n")
        self._tell_left_out()

    def _note(self, words: bytes) -> bool:
        """Log a line if the rate allows it; returns whether it does."""
        if not self._logged.take(len(words) + _LINE_COSTS_BYTES, now_s=self._now_s()):
            return False
        self._tell_left_out()
        level = logging.WARNING if words.startswith(_WARNING) else logging.INFO
        _log.log(level, "%s: %s", self._name, _words(words))
        return True

    def _tell_left_out(self) -> None:
        if self._left_out:
            _log.warning("%s: %d bytes left out, as it prints too much", self._name, self._left_out)
        self._left_out = 0


def _words(text: bytes) -> str:
    return words_of(text.decode(errors="replace"))
