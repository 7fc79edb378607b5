"""What a service instance prints: logged line by line, so much and no more; the last lines explain a crash."""

from __future__ import annotations

import logging
import re
import time
from collections import deque
from collections.abc import Callable

from upwash.core.allowance import Allowance
from upwash.support.text import signal_name, words_of

_log = logging.getLogger("upwash.instance")

_LAST_WORDS = 5  # lines
_LONGEST_LINE = 1000
_LINE_END = re.compile(rb"[\r\n]+")
_LOGGED_BYTES_S = 2048.0  # a log may be kept for months
_LOGGED_AT_ONCE_BYTES = 2**16  # a traceback, or all that a library says of its start
_LINE_COSTS_BYTES = 100  # what a log adds to each line
_READ_BYTES_S = 2.0**18  # from whoever prints faster it is read no faster, until printing has to wait
_READ_AT_ONCE_BYTES = 2**21


def reading_pace() -> Allowance:
    """How fast, in bytes, what one instance prints is to be read."""
    return Allowance(_READ_BYTES_S, at_once=_READ_AT_ONCE_BYTES)


class Output:
    """The output of the instance of that name, progress bars and endless lines included."""

    def __init__(self, name: str, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._name = name
        self._now_s = now_s
        self._rest = b""
        self._last_words: deque[bytes] = deque(maxlen=_LAST_WORDS)
        self._logged = Allowance(_LOGGED_BYTES_S, at_once=_LOGGED_AT_ONCE_BYTES)
        self._left_out = 0  # lines, since the last that was logged

    def add(self, chunk: bytes) -> None:
        """Takes what was printed next."""
        *whole, rest = _LINE_END.split(self._rest + chunk)
        self._rest = rest[-_LONGEST_LINE:]
        self._note([text[:_LONGEST_LINE] for text in whole if text.strip()])

    def explain(self, code: int) -> str:
        """How a process ended that left this output and this code, negative for a signal."""
        self.add(b"\n")
        self._tell_left_out()
        how = f"killed by {signal_name(-code)}" if code < 0 else f"ended with code {code}"
        return f"{how}: {' / '.join(map(_words, self._last_words))}" if self._last_words else how

    def _note(self, lines: list[bytes]) -> None:
        """Logs as many of the lines as it may, without looking at the others: there may be very many."""
        self._last_words.extend(lines[-_LAST_WORDS:])
        for number, text in enumerate(lines):
            if not self._logged.take(len(text) + _LINE_COSTS_BYTES, now_s=self._now_s()):
                self._left_out += len(lines) - number
                return
            self._tell_left_out()
            _log.info("%s: %s", self._name, _words(text))

    def _tell_left_out(self) -> None:
        if self._left_out:
            _log.warning("%s: %d lines left out, as it prints too much", self._name, self._left_out)
        self._left_out = 0


def _words(text: bytes) -> str:
    return words_of(text.decode(errors="replace"))
