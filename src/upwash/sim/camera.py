"""A camera that takes its time and returns nothing worth looking at."""

from __future__ import annotations

import asyncio


class ModelCamera:
    """Returns the same few bytes after `photo_s`: how large a photo is, the radio model knows."""

    def __init__(self, *, photo_s: float) -> None:
        self._photo_s = photo_s

    async def take_photo(self) -> bytes:
        """Waits, and returns the beginning of a JPEG."""
        await asyncio.sleep(self._photo_s)
        return b"\xff\xd8\xff"
