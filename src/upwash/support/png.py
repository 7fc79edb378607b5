"""The chunks of a PNG (ISO/IEC 15948), without its pixels.

signature, IHDR, more chunks, IDAT (one or more), IEND        chunk: length, kind, content, checksum
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_CHUNKS = 50_000  # a camera writes one for 8 kB or more
_AROUND = 12  # bytes of a chunk beside its content
_PIXELS_AT = 33  # after the header
_SHOWN = (b"PLTE", b"IDAT", b"IEND")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the kind of colour
_PIECE = 1 << 20  # bytes


class Header(NamedTuple):
    """What the first chunk says."""

    width_px: int
    height_px: int
    bits: int  # of a channel
    colour: int

    @property
    def is_grey(self) -> bool:
        """Whether the pixels have no colours."""
        return self.colour in (0, 4)

    @property
    def most_bytes(self) -> int:
        """No fewer bytes than the pixels have before their compression, also in seven passes."""
        row = self.width_px * self.bits * _CHANNELS.get(self.colour, 4) // 8 + 16
        return 2 * row * (self.height_px + 8)


class PngChunk(NamedTuple):
    """A chunk's kind, and where the chunk starts and ends."""

    kind: bytes
    start: int
    end: int


def chunks_of(png: bytes) -> Iterator[PngChunk]:
    """The chunks up to the end of the image (IEND), at most MOST_CHUNKS; fewer if the file is cut off."""
    at = len(SIGNATURE)
    for _ in range(MOST_CHUNKS):
        end = at + _AROUND + int.from_bytes(png[at : at + 4])
        if end > len(png):
            return
        kind = png[at + 4 : at + 8]
        yield PngChunk(kind, at, end)
        if kind == b"IEND":
            return
        at = end


def header_of(png: bytes) -> Header | None:
    """What the first chunk says; None if the file is no whole PNG."""
    chunks = list(chunks_of(png)) if png.startswith(SIGNATURE) else []
    if not chunks or chunks[0].kind != b"IHDR" or chunks[-1].kind != b"IEND" or chunks[0].end != _PIXELS_AT:
        return None
    return Header(*struct.unpack_from(">IIBB", png, chunks[0].start + 8))


def shown_of(png: bytes, header: Header) -> bytes | None:
    """A PNG of what a picture needs; None if its data are longer than its pixels.

    Texts and profiles, which can be small in the file and large in memory, are left out, as are further pictures.
    """
    shown = [chunk for chunk in chunks_of(png) if chunk.kind in _SHOWN]
    data = (memoryview(png)[chunk.start + 8 : chunk.end - 4] for chunk in shown if chunk.kind == b"IDAT")
    if _is_longer(data, header.most_bytes):
        return None
    return b"".join((png[:_PIXELS_AT], *(memoryview(png)[chunk.start : chunk.end] for chunk in shown)))


def _is_longer(data: Iterable[memoryview], most_bytes: int) -> bool:
    """Whether compressed data have more bytes than that; False for damaged data, which the decoder refuses."""
    inflating, left = zlib.decompressobj(), most_bytes
    try:
        for part in data:
            rest: bytes | memoryview = part
            while rest and not inflating.eof:
                left -= len(inflating.decompress(rest, _PIECE))
                if left < 0:
                    return True
                rest = inflating.unconsumed_tail
    except zlib.error:
        pass
    return False
