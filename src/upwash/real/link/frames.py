"""How many requests a caller begins and breaks off, by the frame headers of its HTTP/2 connection.

RFC 9113: a connection begins with a preface of 24 bytes. Each frame has a header of 9 bytes: 3 of them are the length
of what follows, the next is the type.
"""

from __future__ import annotations

from dataclasses import dataclass

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_HEADER_BYTES = 9
_DATA, _HEADERS, _RST_STREAM, _WINDOW_UPDATE = 0x0, 0x1, 0x3, 0x8


@dataclass(slots=True)
class Counted:
    """Requests begun, pieces of their bodies, room made for replies, requests broken off, and all other frames."""

    begun: int = 0
    pieces: int = 0
    room: int = 0
    broken_off: int = 0
    idle: int = 0


class FrameCounter:
    """Reads along, and keeps no more than the header that it is in."""

    def __init__(self) -> None:
        self._to_skip = len(PREFACE)
        self._header = bytearray()

    def count(self, chunk: bytes) -> Counted:
        """What begins in the next bytes of the connection."""
        counted, at = Counted(), 0
        while at < len(chunk):
            if self._to_skip:
                skipped = min(self._to_skip, len(chunk) - at)
                self._to_skip -= skipped
                at += skipped
                continue
            missing = _HEADER_BYTES - len(self._header)
            self._header += chunk[at : at + missing]
            at += missing
            if len(self._header) == _HEADER_BYTES:
                self._to_skip = int.from_bytes(self._header[:3], "big")
                _add(counted, self._header[3])
                self._header.clear()
        return counted


def _add(counted: Counted, kind: int) -> None:
    if kind == _HEADERS:
        counted.begun += 1
    elif kind == _RST_STREAM:
        counted.broken_off += 1
    elif kind == _DATA:
        counted.pieces += 1
    elif kind == _WINDOW_UPDATE:
        counted.room += 1
    else:
        counted.idle += 1
