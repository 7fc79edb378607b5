"""Waiting: for what never comes, and for the first of several ends."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, NoReturn, TypeVar

from upwash.support.background import begin, end

T = TypeVar("T")


async def never() -> NoReturn:
    """Waits until it is cancelled."""
    await asyncio.get_running_loop().create_future()
    raise AssertionError("nobody settles this future")


async def first(*waits: Coroutine[Any, Any, T]) -> T:
    """What the first of them returns, or raises; the others are cancelled, and have ended by then."""
    tasks = [begin(wait) for wait in waits]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        winner = next(task for task in tasks if task.done())
    finally:
        await end(*tasks)
    return winner.result()
