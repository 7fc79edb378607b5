"""One log that is followed: the facts it has told so far."""

from __future__ import annotations

import contextlib
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.log import LineReader
from upwash.view.facts import Fact
from upwash.view.news import News
from upwash.view.tail import Tail

_MOST_BYTES = 2**27  # of facts: many days of a flight


@dataclass(frozen=True, slots=True)
class Piece:
    """So many facts that a log told at once, as a JSON array; `start` counts those before them."""

    start: int
    count: int
    json: bytes

    @property
    def end(self) -> int:
        """How many there are with these."""
        return self.start + self.count


def as_one(pieces: Sequence[Piece]) -> Piece:
    """Pieces that follow each other, in one."""
    if len(pieces) == 1:
        return pieces[0]
    facts = b",".join(piece.json[1:-1] for piece in pieces)
    return Piece(pieces[0].start, sum(piece.count for piece in pieces), b"[" + facts + b"]")


class Recording:
    """The last run of a log: its facts, of which there are `count` and more with time, or anew with another `run`.

    `caught_up` says whether everything that the log had when it was last looked at is among them, `trouble` why it is
    read no further.
    """

    def __init__(self, log: Path, keeps: Callable[[str], bool], most_bytes: int | None = None) -> None:
        self.log = log
        self.run = 0
        self.trouble = ""
        self._keeps = keeps
        self._most_bytes = most_bytes or _MOST_BYTES
        self._open()

    def _open(self) -> None:
        self._tail = Tail(self.log)
        self._lines = LineReader(self.log)
        self.caught_up = False
        self._begin()

    def _begin(self) -> None:
        self.news = News(self._keeps)
        self.count = 0
        self._pieces: list[Piece] = []
        self._bytes = 0  # of all of them
        self.run += 1

    def advance(self) -> bool:
        """Takes in a part of what is new, if anything is; what is no event makes the `trouble`."""
        if self.trouble:
            return False
        try:
            content = self._tail.read()
            if content is None and self._tail.was_replaced():
                self._tail.close()
                self._open()
                return True
            self._take(content or b"")
        except UsageError as error:
            self.trouble = str(error)
            return True
        news = content is not None or not self.caught_up
        self.caught_up = self._tail.at_end
        return news

    @property
    def is_behind(self) -> bool:
        """Whether the log has more, which is yet to be read."""
        return not self.caught_up and not self.trouble

    def _take(self, content: bytes) -> None:
        told: list[Fact] = []
        try:
            for event in self._lines.take_all(content):
                if type(event) is schema.LogOpened and (self.count or told):
                    told.clear()
                    self._begin()
                told += self.news.take(event)
            told += self.news.lacks(self._lines.left_out)
        finally:  # the page gets all facts until a line that cannot be read
            if told:
                self._pieces.append(Piece(self.count, len(told), msgspec.json.encode(told)))
                self.count += len(told)
        self._bytes += len(self._pieces[-1].json) if told else 0
        if self._bytes > self._most_bytes:
            raise UsageError(
                f"{self.log} tells more than a page can show: what is after {self._bytes / 1e6:.0f} MB is left out"
            )

    def since(self, count: int) -> Sequence[Piece]:
        """The facts after the first so many, in their order; the first piece may begin with some of those."""
        return self._pieces[bisect_right(self._pieces, count, key=lambda piece: piece.end) :]

    def require_log(self) -> None:
        """Raises UsageError where the file has lines, and none of them is an event."""
        if self._lines.left_out:
            self._lines.require_events()

    def close(self) -> None:
        """Lets go of the log."""
        self._tail.close()


@contextlib.contextmanager
def reading(
    logs: Sequence[Path], keeps: Callable[[str], bool], *, most_bytes: int | None = None
) -> Iterator[list[Recording]]:
    """The recordings of the logs, each read until its first fact, with at most `most_bytes` of facts each.

    Raises UsageError for what is no event log.
    """
    with contextlib.ExitStack() as stack:
        recordings = []
        for log in logs:
            recording = stack.enter_context(contextlib.closing(Recording(log, keeps, most_bytes)))
            while not (recording.count or recording.caught_up or recording.trouble):
                recording.advance()
            if recording.trouble:
                raise UsageError(recording.trouble)
            recording.require_log()
            recordings.append(recording)
        yield recordings
