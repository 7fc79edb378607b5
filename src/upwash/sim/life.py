"""Whether a simulated drone's computer is there: one that vanishes says nothing to anybody, and nobody notices."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine

from upwash.errors import UpwashError


class Life:
    """Of one drone's computer; whatever would be heard of it asks here first."""

    def __init__(self) -> None:
        self.is_over = False


async def lived(program: Coroutine[object, object, None], life: Life, *, until_s: float | None) -> None:
    """Runs the drone's program to its end, or until its life is over; raises what it raises until then.

    What the program still does on its way out, once it is cancelled, must reach nobody.
    """
    if until_s is None:
        await program
        return
    here = asyncio.current_task()
    assert here is not None  # noqa: S101 - a coroutine runs in a task

    def end() -> None:
        life.is_over = True
        here.cancel()

    ending = asyncio.get_running_loop().call_at(until_s, end)
    try:
        await program
    except (UpwashError, asyncio.CancelledError):
        if not life.is_over:
            raise
        here.uncancel()
    finally:
        ending.cancel()
