"""Waiting for what does not come."""

from __future__ import annotations

import asyncio
from typing import NoReturn


async def never() -> NoReturn:
    """Waits until it is cancelled."""
    await asyncio.get_running_loop().create_future()
    raise AssertionError("nobody settles this future")
