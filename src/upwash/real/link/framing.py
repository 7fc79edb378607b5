"""Messages in frames: 4 bytes with the length, the highest first, and so many bytes of MessagePack."""

from __future__ import annotations

from typing import IO

import msgspec

LENGTH_BYTES = 4
BESIDE_BYTES = 4096  # of a frame, beside the request or result in it

_encoder = msgspec.msgpack.Encoder()


def frame(message: msgspec.Struct) -> bytes:
    """The message as it is written."""
    body = _encoder.encode(message)
    return len(body).to_bytes(LENGTH_BYTES) + body


def length_of(head: bytes, *, most_bytes: int) -> int:
    """The length that a frame begins with; raises ValueError for one that is not read."""
    length = int.from_bytes(head)
    if length > most_bytes:
        raise ValueError(f"a frame of {length} bytes, at most {most_bytes} are read")
    return length


def read_frame(stream: IO[bytes], *, most_bytes: int) -> bytes:
    """The next frame's contents; raises EOFError at the end, and ValueError for a frame that is too long."""
    return _whole(stream, length_of(_whole(stream, LENGTH_BYTES), most_bytes=most_bytes))


def _whole(stream: IO[bytes], length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise EOFError("it hung up")
    return data
