"""Lines of a stream, however long they are."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator


async def lines_of(stream: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Each line with its end; a line beyond the stream's limit comes in pieces."""
    while True:
        try:
            yield await stream.readuntil(b"\n")
        except asyncio.LimitOverrunError as longer:
            yield await stream.readexactly(longer.consumed)
        except asyncio.IncompleteReadError as last:
            if last.partial:
                yield last.partial
            return
