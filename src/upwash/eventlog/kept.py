"""The events of one run. In a long run the earlier events lie in an unnamed file, not in memory."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, overload

import msgspec

from upwash.eventlog.log import decode
from upwash.eventlog.schema import Event

_BLOCK = 4_096  # events that go to the file at once, and are read again at once
_IN_MEMORY = 8 * _BLOCK  # a mission of some thousand waypoints: it never needs the file


class KeptEvents(Sequence[Event]):
    """A sequence of events that grows at its end; events in the file are decoded like a log."""

    def __init__(self, events: Iterable[Event] = ()) -> None:
        self._latest: list[Event] = list(events)
        self._file: IO[bytes] | None = None
        self._blocks: list[tuple[int, int]] = []  # of the file: begin and length
        self._read: tuple[int, list[Event]] = (-1, [])  # the block that was read last

    def append(self, event: Event) -> None:
        """Adds an event."""
        if len(self._latest) >= _IN_MEMORY:
            self._put_away(_IN_MEMORY - _BLOCK)
        self._latest.append(event)

    def lines(self) -> Iterator[bytes]:
        """The events as the content of a log, in pieces of whole lines."""
        for begin, length in self._blocks:
            yield self._bytes_at(begin, length)
        for begin in range(0, len(self._latest), _BLOCK):
            yield _encoded(self._latest[begin : begin + _BLOCK])

    def as_read(self) -> KeptEvents:
        """The same events after a pass through a log: encoded and decoded."""
        if self._blocks:
            self._put_away(len(self._latest) // _BLOCK * _BLOCK)
        self._latest = _decoded(_encoded(self._latest))
        return self

    def __len__(self) -> int:
        return len(self._blocks) * _BLOCK + len(self._latest)

    def __iter__(self) -> Iterator[Event]:
        for block in range(len(self._blocks)):
            yield from self._block(block)
        yield from self._latest

    @overload
    def __getitem__(self, index: int) -> Event: ...
    @overload
    def __getitem__(self, index: slice) -> list[Event]: ...
    def __getitem__(self, index: int | slice) -> Event | list[Event]:
        if isinstance(index, slice):
            return [self[position] for position in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        block, within = divmod(number, _BLOCK)
        if block < len(self._blocks):
            return self._block(block)[within]
        return self._latest[number - len(self._blocks) * _BLOCK]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, (KeptEvents, list)):
            return NotImplemented
        return len(self) == len(other) and all(one == two for one, two in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} events)"

    def __reduce__(self) -> tuple[type[KeptEvents], tuple[list[Event]]]:
        return type(self), (list(self),)

    def _put_away(self, count: int) -> None:
        """Move `count` events, a multiple of a block, from memory to the file."""
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
            weakref.finalize(self, self._file.close)
        for begin in range(0, count, _BLOCK):
            content = _encoded(self._latest[begin : begin + _BLOCK])
            self._blocks.append((self._file.seek(0, 2), len(content)))
            self._file.write(content)
        del self._latest[:count]

    def _block(self, number: int) -> list[Event]:
        if self._read[0] != number:
            self._read = number, _decoded(self._bytes_at(*self._blocks[number]))
        return self._read[1]

    def _bytes_at(self, begin: int, length: int) -> bytes:
        assert self._file is not None  # noqa: S101 - there is a block
        self._file.seek(begin)
        return self._file.read(length)


def lines_of(events: Sequence[Event]) -> Iterator[bytes]:
    """Events as the content of a log, in pieces of whole lines."""
    return events.lines() if isinstance(events, KeptEvents) else KeptEvents(events).lines()


def _encoded(events: Sequence[Event]) -> bytes:
    return b"".join(msgspec.json.encode(event) + b"\n" for event in events)


def _decoded(lines: bytes) -> list[Event]:
    return [decode(line) for line in lines.splitlines()]
