"""One log that is followed: the facts it has told so far."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.log import LineReader
from upwash.view.story import Story
from upwash.view.tail import Tail


class Recording:
    """The last run of a log: its `facts` as JSON, which grow, or begin anew with another `run`.

    `caught_up` says whether everything that the log had when it was last looked at is among them, `trouble` why it is
    read no further.
    """

    def __init__(self, log: Path, keeps: Callable[[str], bool]) -> None:
        self.log = log
        self.run = 0
        self.caught_up = False
        self.trouble = ""
        self._keeps = keeps
        self._tail = Tail(log)
        self._lines = LineReader(log)
        self._begin()

    def _begin(self) -> None:
        self.story = Story(self._keeps)
        self.facts: list[bytes] = []
        self.run += 1

    def advance(self) -> bool:
        """Takes in a part of what is new, if anything is; what is no event makes the `trouble`."""
        if self.trouble:
            return False
        try:
            lines = self._tail.read()
            if lines is None and self._tail.was_replaced():
                self._start_over()
                return True
            for line in lines or ():
                self._take(line)
        except UsageError as error:
            self.trouble = str(error)
            return True
        news = lines is not None or not self.caught_up
        self.caught_up = lines is None
        return news

    def _start_over(self) -> None:
        self._tail.close()
        self._tail = Tail(self.log)
        self._lines = LineReader(self.log)
        self._begin()

    def _take(self, line: bytes) -> None:
        event = self._lines.take(line)
        if event is None:
            return
        if isinstance(event, schema.LogOpened) and self.facts:
            self._begin()
        self.facts += map(msgspec.json.encode, self.story.take(event))

    def close(self) -> None:
        """Lets go of the log."""
        self._tail.close()


@contextlib.contextmanager
def reading(logs: Sequence[Path], keeps: Callable[[str], bool]) -> Iterator[list[Recording]]:
    """The recordings of the logs, each read a little; raises UsageError for what is no event log."""
    with contextlib.ExitStack() as stack:
        recordings = []
        for log in logs:
            recording = stack.enter_context(contextlib.closing(Recording(log, keeps)))
            recording.advance()
            if recording.trouble:
                raise UsageError(recording.trouble)
            recordings.append(recording)
        yield recordings
