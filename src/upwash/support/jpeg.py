"""The segments of a JPEG (ITU-T T.81, annex B), without its pixels.

    SOI, segments, SOS, compressed data, more segments and scans, EOI        segment: 0xff, marker, length, content

Compressed data is skipped by a search, not byte by byte: a photo costs a few per cent of what its decoding costs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

SOI = b"\xff\xd8"
SOS, EOI = 0xDA, 0xD9
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # which say the size
MOST_SEGMENTS = 1000  # a camera writes 10 to 30, and one for each 65 kB that it adds

# Padding and markers without content may stand before a segment; within compressed data they are no markers.
_NEXT = re.compile(rb"(?:\xff++[\x01\xd0-\xd7])*+\xff++[\xc0-\xcf\xd8-\xfe]")
_NEXT_IN_DATA = re.compile(rb"\xff[\xc0-\xcf\xd8-\xfe]")


class Segment(NamedTuple):
    """A marker, and where it starts; its content begins 4 bytes later, and ends where the segment does."""

    marker: int
    start: int
    end: int


def segments_of(jpeg: bytes) -> Iterator[Segment]:
    """The segments up to the end of the image (EOI), at most MOST_SEGMENTS; fewer if the bytes are no JPEG."""
    if not jpeg.startswith(SOI):
        return
    find, at, marker = _NEXT.match, len(SOI), None
    for _ in range(MOST_SEGMENTS):
        if marker == EOI or (found := find(jpeg, at)) is None:
            return
        start, at, marker = found.end() - 2, found.end(), jpeg[found.end() - 1]
        if marker != EOI:
            at += int.from_bytes(jpeg[at : at + 2])
            if at > len(jpeg):
                return
        yield Segment(marker, start, at)
        if marker == SOS:
            find = _NEXT_IN_DATA.search


def size_of(jpeg: bytes) -> tuple[int, int] | None:
    """The width and the height that the first frame states, in pixels; None if none does."""
    frame = next((segment for segment in segments_of(jpeg) if segment.marker in FRAMES), None)
    return None if frame is None else size_in(jpeg, frame)


def size_in(jpeg: bytes, frame: Segment) -> tuple[int, int]:
    """The width and the height that a frame states, in pixels."""
    height, width = (int.from_bytes(jpeg[frame.start + at : frame.start + at + 2]) for at in (5, 7))
    return width, height
