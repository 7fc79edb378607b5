"""Objects that a scenario draws on the ground, as a photo carries them to a modelled detector."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from msgspec import Struct

_BEGIN, _END = b"objects drawn here: ", b"\n"


class ShownObject(Struct, frozen=True):
    """A drawn object in a photo, in its pixels, with the score that a detector has for it."""

    label: str
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    score: float


def drawn(shown: Sequence[ShownObject]) -> bytes:
    """What a photo has of the objects that it shows."""
    return _BEGIN + msgspec.json.encode(shown) + _END


def shown_in(photo: bytes) -> list[ShownObject] | None:
    """The objects that a photo shows, or a request with one; None without drawn objects."""
    _, begin, rest = photo.partition(_BEGIN)
    return msgspec.json.decode(rest.partition(_END)[0], type=list[ShownObject]) if begin else None
