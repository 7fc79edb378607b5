"""MessagePack, where everything that can be wrong with foreign bytes is one error."""

from __future__ import annotations

from typing import TypeVar

import msgspec

T = TypeVar("T")


def decode(data: bytes, decoder: msgspec.msgpack.Decoder[T]) -> T:
    """The value, checked against the decoder's type; raises msgspec.MsgspecError for anything else."""
    try:
        return decoder.decode(data)
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(f"text that is not UTF-8: {error}") from error
    except RecursionError as error:
        raise msgspec.DecodeError("nested too deeply") from error
