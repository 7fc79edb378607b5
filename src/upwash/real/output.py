"""What a service instance prints: logged line by line, the last lines kept to explain a crash."""

from __future__ import annotations

import logging
import re
import signal
from collections import deque

_log = logging.getLogger("upwash.instance")

_LAST_WORDS = 5  # lines
_LONGEST_LINE = 1000
_LINE_END = re.compile(rb"[\r\n]+")


class Output:
    """The output of the instance of that name, progress bars and endless lines included."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._rest = b""
        self._last_words: deque[str] = deque(maxlen=_LAST_WORDS)

    def add(self, chunk: bytes) -> None:
        """Takes what was printed next."""
        *whole, rest = _LINE_END.split(self._rest + chunk)
        self._rest = rest[-_LONGEST_LINE:]
        for text in whole:
            self._note(text)

    def explain(self, code: int) -> str:
        """How a process ended that left this output and this code, negative for a signal."""
        self._note(self._rest)
        self._rest = b""
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return f"{how}: {' / '.join(self._last_words)}" if self._last_words else how

    def _note(self, text: bytes) -> None:
        words = text[:_LONGEST_LINE].decode(errors="replace").strip()
        if words:
            self._last_words.append(words)
            _log.info("%s: %s", self._name, words)
