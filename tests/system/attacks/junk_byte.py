"""One byte that means nothing, sent to the drone's `udpin` port again and again."""

from __future__ import annotations

import asyncio

from tests.system.attacks.flown import Stranger, Target, main

EVERY_S = 0.002


async def junk(_: Target, stranger: Stranger) -> None:
    """Never ends by itself."""
    while True:
        stranger.send(b"\x00")
        await asyncio.sleep(EVERY_S)


if __name__ == "__main__":
    main(junk)
