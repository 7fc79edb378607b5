"""What long work says meanwhile on standard error: what it does, how much of it is done, and how much time is left.

    with shown("check"):                                   a command: says what of its work is under way
        with work("missions flown", total=20) as done:     a part of it, anywhere below
            done()

Work of less than two seconds says nothing. A terminal shows one line, which changes; elsewhere a line comes each
10 s.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import TextIO

from upwash.support.background import only_logged, thread
from upwash.support.text import duration

_QUIET_S = 2.0
_LINE_EVERY_S = 10.0
_LOOK_EVERY_S = 0.5


@dataclass(slots=True)
class _Work:
    what: str
    total: int | None
    began_s: float
    done: int = 0

    def told(self) -> str:
        if self.total is None:
            return f"{self.what}: {self.done}" if self.done else self.what
        return f"{self.what}: {self.done} of {self.total}"

    def left_s(self, now_s: float) -> float | None:
        if not self.total or not self.done:
            return None
        return (now_s - self.began_s) * (self.total - self.done) / self.done


class Progress:
    """The work of one command, and its reports in `file`, by the time of `clock`."""

    def __init__(self, command: str, file: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        self._command = command
        self._file = file
        self._clock = clock
        self._rewrites = file.isatty()
        self._work: list[_Work] = []
        self._said_s: float | None = None
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def work(self, what: str, total: int | None) -> Iterator[Callable[..., None]]:
        """A part of the work, within the parts that are under way; call the result after each step.

        The result's `total` and `what` take the place of those that were given.
        """
        part = _Work(what, total, self._clock())
        self._work.append(part)

        def done(count: int = 1, *, total: int | None = total, what: str = what) -> None:
            part.done, part.total, part.what = part.done + count, total, what

        try:
            yield done
        finally:
            with self._lock:
                self._work.remove(part)
                if not self._work:
                    self._wipe()

    def look(self) -> None:
        """Report what is under way, if a report is due."""
        with self._lock:
            now_s = self._clock()
            if not self._work or now_s - self._work[0].began_s < _QUIET_S:
                return
            if self._rewrites:
                width = shutil.get_terminal_size().columns - 1
                self._write(f"\r{self._line(now_s)[:width]}\x1b[K")
            elif self._said_s is None or now_s - self._said_s >= _LINE_EVERY_S:
                self._write(f"{self._line(now_s)}\n")
            else:
                return
            self._said_s = now_s

    def _line(self, now_s: float) -> str:
        parts = "; ".join(part.told() for part in self._work)
        said = f"{self._command}: {parts}; {duration(now_s - self._work[0].began_s)} so far"
        whole = next((part for part in self._work if part.total), None)
        left_s = None if whole is None else whole.left_s(now_s)
        return said if left_s is None else f"{said}, about {duration(left_s)} left"

    def _wipe(self) -> None:
        if self._rewrites and self._said_s is not None:
            self._write("\r\x1b[K")
            self._said_s = None

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # the file has lost its reader
            self._file.write(text)
            self._file.flush()


_shown: Progress | None = None


@contextlib.contextmanager
def shown(command: str) -> Generator[None]:
    """Says what work of this process is under way, until the block ends."""
    global _shown  # noqa: PLW0603 - a process has one standard error
    progress, over = Progress(command, sys.stderr), threading.Event()

    def watch() -> None:
        while not over.wait(_LOOK_EVERY_S):
            progress.look()

    watching = thread(watch, name="progress", failed=only_logged)
    before, _shown = _shown, progress
    watching.start()
    try:
        yield
    finally:
        _shown = before
        over.set()
        watching.join()


@contextlib.contextmanager
def work(what: str, total: int | None = None) -> Generator[Callable[..., None]]:
    """A part of the work of this process, of `total` steps if that is known; call the result after each step."""
    if _shown is None or threading.current_thread() is not threading.main_thread():
        yield lambda *_, **__: None
        return
    with _shown.work(what, total) as done:
        yield done
