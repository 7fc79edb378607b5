"""TIFF as EXIF has it: byte order, offset of the first directory, directories, values; read with care, and added to.

A directory is copied with changed entries to the end: all that it refers to stays in its place.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED = 1, 2, 3, 4, 5, 7
EMPTY = b"II*\0" + bytes(4)
ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
ENTRY, COUNT, OFFSET = 12, 2, 4  # bytes
_INLINE = 4  # bytes of a value that stand in its entry
_MOST = 100  # of the parts of a value that is read


class Value(NamedTuple):
    """The value of an entry."""

    kind: int
    length: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Directory:
    """A directory of a TIFF: its entries, each without its tag, and the offset of the directory after it."""

    tiff: bytes
    order: str
    entries: Mapping[int, bytes] = field(default_factory=dict)
    following: bytes = bytes(OFFSET)

    @classmethod
    def first_of(cls, tiff: bytes) -> Directory | None:
        """The TIFF's first directory; None where it cannot be read."""
        order = ORDERS.get(tiff[:4])
        if order is None or len(tiff) < 8:
            return None
        (first,) = struct.unpack_from(f"{order}I", tiff, 4)
        return cls._at(tiff, order, first) if first else cls(tiff, order)

    def inner(self, tag: int) -> Directory | None:
        """The directory that an entry leads to; None where no directory can be read."""
        if tag not in self.entries:
            return None
        (at,) = struct.unpack_from(f"{self.order}I", self.entries[tag], 6)
        return self._at(self.tiff, self.order, at)

    @classmethod
    def _at(cls, tiff: bytes, order: str, at: int) -> Directory | None:
        if at + COUNT > len(tiff):
            return None
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        end = at + COUNT + count * ENTRY
        if end + OFFSET > len(tiff):
            return None
        starts = range(at + COUNT, end, ENTRY)
        entries = {
            struct.unpack_from(f"{order}H", tiff, start)[0]: tiff[start + 2 : start + ENTRY]
            for start in starts
        }
        return cls(tiff, order, entries, tiff[end : end + OFFSET])

    def text(self, tag: int) -> str:
        """A text without spaces around it; "" without one."""
        return self._data(tag, ASCII, 1).decode("latin-1").strip(" \0\t")

    def numbers(self, tag: int) -> tuple[float, ...]:
        """The fractions of a value, NaN for a division by 0; () where the entry is missing."""
        data = self._data(tag, RATIONAL, 8)
        parts = struct.unpack(f"{self.order}{len(data) // 4}I", data)
        pairs = zip(parts[::2], parts[1::2], strict=True)
        return tuple(above / below if below else math.nan for above, below in pairs)

    def _data(self, tag: int, kind: int, size: int) -> bytes:
        entry = self.entries.get(tag, bytes(ENTRY - 2))
        found, count, at = struct.unpack(f"{self.order}HII", entry)
        length = count * size
        if found != kind or count > _MOST:
            return b""
        data = entry[6 : 6 + length] if length <= _INLINE else self.tiff[at : at + length]
        return data if len(data) == length else b""


def append(tiff: bytearray, values: Mapping[int, Value], order: str) -> int:
    """Adds a directory with its values behind it; returns its offset."""
    at = len(tiff)
    data_at = at + COUNT + len(values) * ENTRY + OFFSET
    directory, data = bytearray(struct.pack(f"{order}H", len(values))), bytearray()
    for tag, value in sorted(values.items()):
        directory += struct.pack(f"{order}HHI", tag, value.kind, value.length)
        if len(value.data) <= _INLINE:
            directory += value.data.ljust(_INLINE, b"\0")
        else:
            directory += struct.pack(f"{order}I", data_at + len(data))
            data += value.data + bytes(len(value.data) % 2)
    tiff += directory + bytes(OFFSET) + data
    return at


def pointer(offset: int, order: str) -> bytes:
    """An entry, without its tag, that leads to the directory at that offset."""
    return struct.pack(f"{order}HII", LONG, 1, offset)


def text(words: str) -> Value:
    """A text as a value."""
    data = words.encode("ascii") + b"\0"
    return Value(ASCII, len(data), data)


def rationals(order: str, *pairs: tuple[int, int]) -> Value:
    """Fractions as a value."""
    return Value(RATIONAL, len(pairs), struct.pack(f"{order}{2 * len(pairs)}I", *sum(pairs, ())))
